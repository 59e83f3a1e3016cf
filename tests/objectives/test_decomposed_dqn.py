"""The loss against what it must equal: scalar double DQN, the sum over components, exact values, and its own dense
self.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn
from torchrl.objectives import HardUpdate, ValueEstimators

from tests.toy import PATCHES, exact_values
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import LocalGeometry, UNet
from xqmap.objectives import DecomposedDQNLoss

STATES, ACTIONS = 6, 5


class Table(TensorDictModuleBase):
    """Q_k(s, a) as numbers: the smallest network that the loss accepts."""

    def __init__(self, components: int, weights: Sequence[float] | None = None) -> None:
        super().__init__()
        self.in_keys = ["heightmap"]
        self.out_keys = ["component_action_value", "action_value"]
        self.values = nn.Parameter(torch.randn(STATES, components, ACTIONS))
        self.weights = torch.ones(components) if weights is None else torch.tensor(weights)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        maps = self.values[tensordict["heightmap"]]
        tensordict["component_action_value"] = maps
        tensordict["action_value"] = (maps * self.weights[:, None]).sum(-2)
        return tensordict


def transitions(components: int, count: int = 64, seed: int = 0) -> TensorDict:
    generator = torch.Generator().manual_seed(seed)
    reward = torch.rand(count, components, generator=generator)
    done = torch.rand(count, 1, generator=generator) < 0.3
    following = {"heightmap": torch.randint(STATES, (count,), generator=generator), "reward_components": reward}
    following |= {"done": done, "terminated": done.clone(), "reward": reward.sum(-1, keepdim=True)}
    state = torch.randint(STATES, (count,), generator=generator)
    action = torch.randint(ACTIONS, (count,), generator=generator)
    return TensorDict({"heightmap": state, "action": action, "next": following}, batch_size=[count])


def make_loss(
    network: TensorDictModuleBase, components: Sequence[str], gamma: float = 0.9, **settings: Any
) -> DecomposedDQNLoss:
    loss = DecomposedDQNLoss(network, components=components, **settings)
    loss.make_value_estimator(gamma=gamma)
    return loss


@pytest.mark.parametrize("double_dqn", [True, False])
def test_one_component_is_scalar_double_dqn(double_dqn: bool) -> None:
    torch.manual_seed(0)
    network = Table(1)
    loss = make_loss(network, ["reward"], double_dqn=double_dqn, loss_function="l2")
    loss.target_value_network_params.apply(lambda p: p.data.normal_())
    batch = transitions(1)
    online, target = network.values[:, 0], loss.target_value_network_params["values"][:, 0]
    state, following = batch["heightmap"], batch["next", "heightmap"]
    best = (online if double_dqn else target)[following].argmax(-1)
    goes_on = (~batch["next", "terminated"]).squeeze(-1)
    expected = batch["next", "reward_components"].squeeze(-1) + 0.9 * goes_on * target[following].gather(
        -1, best[:, None]
    ).squeeze(-1)
    error = (online[state].gather(-1, batch["action"][:, None]).squeeze(-1) - expected.detach()) ** 2
    assert torch.allclose(loss(batch)["loss_reward"], error.mean())


def test_targets_of_components_sum_to_the_scalar_target() -> None:
    torch.manual_seed(1)
    network = Table(3)
    loss = make_loss(network, ["a", "b", "c"])
    loss.target_value_network_params.apply(lambda p: p.data.normal_())
    batch = transitions(3)
    targets = loss._targets(batch)[0]
    summed, summed_target = network.values.sum(1), loss.target_value_network_params["values"].sum(1)
    following = batch["next", "heightmap"]
    best = summed[following].argmax(-1, keepdim=True)
    goes_on = ~batch["next", "terminated"]
    expected = batch["next", "reward"] + 0.9 * goes_on * summed_target[following].gather(-1, best)
    assert torch.allclose(targets.sum(-1, keepdim=True), expected, atol=1e-6)


def test_weights_decide_the_shared_action() -> None:
    torch.manual_seed(2)
    network = Table(2, weights=[5.0, 0.1])
    loss = make_loss(network, ["a", "b"], gamma=1.0)
    batch = transitions(2)
    batch["next", "terminated"][:] = False
    best = (network.values * torch.tensor([5.0, 0.1])[:, None]).sum(1)[batch["next", "heightmap"]].argmax(-1)
    future = network.values[batch["next", "heightmap"]].gather(-1, best[:, None, None].expand(-1, 2, 1)).squeeze(-1)
    assert torch.allclose(loss._targets(batch)[0], batch["next", "reward_components"] + future)


def test_mask_limits_the_next_action() -> None:
    torch.manual_seed(3)
    network = Table(2)
    loss = make_loss(network, ["a", "b"], gamma=1.0)
    batch = transitions(2)
    batch["next", "terminated"][:] = False
    only = torch.zeros(64, ACTIONS, dtype=torch.bool)
    only[:, 2] = True
    batch["next", "action_mask"] = only
    future = network.values[batch["next", "heightmap"]][..., 2]
    assert torch.allclose(loss._targets(batch)[0], batch["next", "reward_components"] + future)


def test_own_maxima_promise_at_least_as_much() -> None:
    torch.manual_seed(4)
    network = Table(2)
    batch = transitions(2)
    shared = make_loss(network, ["a", "b"], shared_argmax=True)._targets(batch)[0]
    own = make_loss(network, ["a", "b"], shared_argmax=False)._targets(batch)[0]
    assert bool((own >= shared - 1e-6).all())
    assert float((own - shared).max()) > 0.1


@pytest.mark.parametrize("estimator", [ValueEstimators.TD0, ValueEstimators.TD1, ValueEstimators.TDLambda])
def test_estimators(estimator: ValueEstimators) -> None:
    loss = DecomposedDQNLoss(Table(2), components=["a", "b"])
    loss.make_value_estimator(estimator, gamma=0.5)
    assert torch.isfinite(loss(transitions(2))["loss_a"])


def test_unfit_estimator_is_refused() -> None:
    with pytest.raises(NotImplementedError, match="TD0"):
        DecomposedDQNLoss(Table(2), components=["a", "b"]).make_value_estimator(ValueEstimators.GAE)


def test_n_step_discount_reaches_every_component() -> None:
    torch.manual_seed(5)
    network = Table(2)
    batch = transitions(2)
    batch["next", "terminated"][:] = False
    one = make_loss(network, ["a", "b"])._targets(batch)[0] - batch["next", "reward_components"]
    batch["steps_to_next_obs"] = torch.full((64, 1), 3)
    three = make_loss(network, ["a", "b"])._targets(batch)[0] - batch["next", "reward_components"]
    assert torch.allclose(three, one * 0.9**2, atol=1e-6)


def toy_transitions() -> TensorDict:
    """Every transition of the toy world's first two decisions. States: the patches that are left."""
    subsets = [(0, 1, 2), (1, 2), (0, 2), (0, 1)]
    rows = []
    for made, subset in [(0, subsets[0]), *((1, s) for s in subsets[1:])]:
        for patch in subset:
            left = tuple(i for i in subset if i != patch)
            following = subsets.index(left) if left in subsets else 0
            rows.append((subsets.index(subset), patch, PATCHES[patch][2], following, made == 1))
    mask = torch.zeros(len(rows), ACTIONS, dtype=torch.bool)
    for i, row in enumerate(rows):
        mask[i, list(subsets[row[3]])] = True
    done = torch.tensor([[row[4]] for row in rows])
    following = {
        "heightmap": torch.tensor([row[3] for row in rows]),
        "reward_components": torch.tensor([row[2] for row in rows]),
    }
    following |= {"done": done, "terminated": done, "action_mask": mask}
    return TensorDict(
        {
            "heightmap": torch.tensor([r[0] for r in rows]),
            "action": torch.tensor([r[1] for r in rows]),
            "next": following,
        },
        batch_size=[len(rows)],
    )


def test_toy_world_is_learned_to_its_exact_values() -> None:
    """All Q*_k of the first decision come out, not only their sum."""
    torch.manual_seed(0)
    network = Table(2)
    loss = make_loss(network, ["left", "right"], gamma=0.5, loss_function="l2")
    updater = HardUpdate(loss, value_network_update_interval=20)
    optimizer = torch.optim.Adam(loss.parameters(), lr=0.05)
    batch = toy_transitions()
    for _ in range(600):
        losses = loss(batch)
        optimizer.zero_grad()
        (losses["loss_left"] + losses["loss_right"]).backward()
        optimizer.step()
        updater.step()
    for patch, exact in exact_values((0, 1, 2), 0, 0.5).items():
        assert torch.allclose(network.values[0, :, patch], torch.tensor(exact, dtype=torch.float32), atol=1e-3)


@pytest.mark.parametrize("reduction", ["mean", "sum", "none"])
def test_reductions(reduction: Any) -> None:
    torch.manual_seed(6)
    network = Table(2)
    plain = make_loss(network, ["a", "b"], reduction="none")(transitions(2))["loss_a"]
    reduced = make_loss(network, ["a", "b"], reduction=reduction)(transitions(2))["loss_a"]
    assert torch.allclose(reduced, {"mean": plain.mean(), "sum": plain.sum(), "none": plain}[reduction])


def test_priority_weights_weigh_each_transition_and_ones_change_nothing() -> None:
    torch.manual_seed(6)
    network, batch = Table(2), transitions(2)
    plain = make_loss(network, ["a", "b"])(batch)["loss_b"]
    each = make_loss(network, ["a", "b"], reduction="none")(batch)["loss_b"]
    weight = torch.rand(64)
    ones, weighed = (
        make_loss(network, ["a", "b"])(batch.clone().set("priority_weight", w))["loss_b"]
        for w in (torch.ones(64), weight)
    )
    assert torch.equal(ones, plain)
    assert torch.allclose(weighed, (each * weight).mean())


def test_only_the_priority_is_written() -> None:
    batch = transitions(2)
    before = batch.clone()
    make_loss(Table(2), ["a", "b"])(batch)
    assert set(batch.keys(True, True)) - set(before.keys(True, True)) == {"td_error"}
    assert all(torch.equal(batch[key], before[key]) for key in before.keys(True, True))


def test_keys_can_be_renamed_and_unknown_ones_are_refused() -> None:
    torch.manual_seed(7)
    network = Table(2)
    expected = make_loss(network, ["a", "b"])(transitions(2))["loss_a"]
    batch = transitions(2)
    batch["next", "info", "r"] = batch["next"].pop("reward_components")
    loss = make_loss(network, ["a", "b"])
    loss.set_keys(reward=("info", "r"))
    assert torch.allclose(loss(batch)["loss_a"], expected)
    with pytest.raises(ValueError, match="rewardd"):
        loss.set_keys(rewardd="r")


def test_call_by_keyword() -> None:
    torch.manual_seed(8)
    loss = make_loss(Table(2), ["a", "b"])
    batch = transitions(2)
    out = loss(
        heightmap=batch["heightmap"],
        action=batch["action"],
        next_heightmap=batch["next", "heightmap"],
        next_reward_components=batch["next", "reward_components"],
        next_done=batch["next", "done"],
        next_terminated=batch["next", "terminated"],
    )
    assert torch.allclose(out[loss.out_keys.index("loss_a")], loss(batch)["loss_a"])


def test_target_moves_only_by_its_updater() -> None:
    torch.manual_seed(9)
    loss = make_loss(Table(2), ["a", "b"])
    updater = HardUpdate(loss, value_network_update_interval=1)
    before = loss.target_value_network_params["values"].clone()
    optimizer = torch.optim.SGD([p for p in loss.parameters() if p.requires_grad], lr=1.0)
    losses = loss(transitions(2))
    (losses["loss_a"] + losses["loss_b"]).backward()
    optimizer.step()
    assert torch.equal(loss.target_value_network_params["values"], before)
    updater.step(), updater.step()
    assert torch.equal(loss.target_value_network_params["values"], loss.value_network_params["values"])


# -- maps ----------------------------------------------------------------------------------------------------------


def qmaps(width: int = 4, depth: int = 2, network: type[QMaps] = QMaps) -> QMaps:
    stem = LocalGeometry(0.1, 1.0, [3, 5], 5, 5.0)
    return network(["a", "b"], stem, lambda channels: UNet(channels, width, depth))


class Dense(QMaps):
    """The same maps; made from another class, they are computed whole."""


def between_maps(rows: int, columns: int, action: torch.Tensor) -> TensorDict:
    """Transitions between random heightmaps, none of them the last."""
    count = len(action)
    over = torch.zeros(count, 1, dtype=torch.bool)
    following = {"heightmap": torch.rand(count, 4, rows, columns), "reward_components": torch.rand(count, 2)}
    state = {"heightmap": torch.rand(count, 4, rows, columns), "action": action}
    return TensorDict({**state, "next": {**following, "done": over, "terminated": over}}, [count])


@pytest.mark.parametrize("settings", [{}, {"double_dqn": False}, {"shared_argmax": False}])
def test_the_cells_that_count_give_the_whole_maps_loss_and_gradient(settings: dict[str, Any]) -> None:
    torch.manual_seed(10)
    batch = between_maps(53, 60, torch.randint(53 * 60, (12,)))
    results = []
    for kind in (Dense, QMaps):
        torch.manual_seed(11)
        loss = make_loss(qmaps(network=kind), ["a", "b"], **settings)
        assert loss.has_cone == (kind is QMaps)
        out = loss(batch.clone())
        (out["loss_a"] + out["loss_b"]).backward()
        gradients = {name: p.grad for name, p in loss.named_parameters() if p.grad is not None}
        results.append((out["loss_a"].detach(), gradients))
    (dense, dense_gradients), (cone, cone_gradients) = results
    assert torch.allclose(dense, cone, atol=1e-5)
    assert dense_gradients.keys() == cone_gradients.keys() and dense_gradients
    assert all(torch.allclose(dense_gradients[n], cone_gradients[n], atol=1e-5) for n in dense_gradients)
