"""Batches as they come: from torchrl's own n-step transforms, with or without a last axis of 1, in any type. What the
loss cannot mean is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import Binary, Categorical, LazyTensorStorage, OneHot, TensorDictReplayBuffer
from torchrl.data.postprocs import MultiStep
from torchrl.envs.transforms import MultiStepTransform
from torchrl.objectives import ValueEstimators

from tests.objectives.test_decomposed_dqn import ACTIONS, STATES, Dense, Table, make_loss, qmaps, transitions
from tests.toy import ToyTask
from xqmap.collectors import worker
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.models.policy import GreedyPolicy
from xqmap.models.qmaps import QMaps
from xqmap.objectives import DecomposedDQNLoss

NAMES = ("a", "b")


def full(count: int = 64, components: int = 2) -> TensorDict:
    """A batch with everything that the loss may read."""
    generator = torch.Generator().manual_seed(1)
    batch = transitions(components, count)
    batch["priority_weight"] = torch.rand(count, generator=generator)
    batch["steps_to_next_obs"] = torch.randint(1, 4, (count,), generator=generator)
    batch["next", "action_mask"] = torch.rand(count, ACTIONS, generator=generator) < 0.5
    batch["next", "truncated"] = torch.zeros(count, 1, dtype=torch.bool)
    return batch


def losses(batch: TensorDictBase, **settings: Any) -> Tensor:
    """``[K]`` of a network that is always the same."""
    torch.manual_seed(0)
    loss = make_loss(Table(2), NAMES, **settings)
    out = loss(batch)
    return torch.stack([out[f"loss_{name}"] for name in NAMES])


NUMBERS = ["action", "priority_weight", "steps_to_next_obs", ("next", "done"), ("next", "terminated")]


@pytest.mark.parametrize("key", NUMBERS)
def test_a_last_axis_of_one_means_nothing(key: Any) -> None:
    flat, upright = full(), full()
    flat[key], upright[key] = flat[key].reshape(64), upright[key].reshape(64, 1)
    assert torch.equal(losses(flat), losses(upright))
    assert upright["td_error"].shape == (64,)


def test_with_one_component_rewards_and_flags_may_be_plain_vectors() -> None:
    torch.manual_seed(0)
    loss, batch = make_loss(Table(1), ["r"]), full(components=1)
    expected = loss(batch)["loss_r"]
    for key in (("next", "reward_components"), ("next", "done"), ("next", "terminated")):
        batch[key] = batch[key].reshape(64)
    assert torch.equal(loss(batch)["loss_r"], expected)


@pytest.mark.parametrize(
    ("key", "shape", "wanted"),
    [
        *((key, (64, 2), r"\[64\] or \[64, 1\]") for key in NUMBERS if key != "action"),
        ("priority_weight", (64, 64), r"\[64\] or \[64, 1\]"),
        ("action", (64, 2), r"\[64\].*action_space='one-hot'"),
        (("next", "reward_components"), (64,), r"\[64, 2\].*a, b"),
        (("next", "reward_components"), (64, 1), r"\[64, 2\].*a, b"),
        (("next", "reward_components"), (64, 3), r"\[64, 2\].*a, b"),
        (("next", "action_mask"), (64, ACTIONS + 1), rf"\[\d+, {ACTIONS}\]"),
        (("next", "action_mask"), (64, 1, ACTIONS), rf"\[\d+, {ACTIONS}\]"),
    ],
)
def test_another_shape_is_refused_with_key_shape_and_what_was_wanted(key: Any, shape: Any, wanted: str) -> None:
    batch = full()
    batch[key] = torch.ones(shape, dtype=batch[key].dtype)
    batch["next", "terminated" if "done" in key else "done"][:] = False
    name, found = key if isinstance(key, str) else key[-1], ", ".join(str(n) for n in shape[1:])
    with pytest.raises(ValueError, match=rf"{name} is \w+ \[\d+,? ?{found}\], must be .*{wanted}"):
        losses(batch)


@pytest.mark.parametrize(
    ("key", "dtype"),
    [
        ("action", torch.int32),
        ("action", torch.float64),
        ("priority_weight", torch.float64),
        ("steps_to_next_obs", torch.int32),
        (("next", "done"), torch.uint8),
        (("next", "terminated"), torch.uint8),
        (("next", "terminated"), torch.float32),
        (("next", "action_mask"), torch.uint8),
        (("next", "reward_components"), torch.float64),
    ],
)
def test_the_type_of_an_entry_means_nothing(key: Any, dtype: torch.dtype) -> None:
    plain, other = full(), full()
    other[key] = other[key].to(dtype)
    assert torch.allclose(losses(plain), losses(other))
    assert losses(other).dtype == torch.float32


def test_whole_and_half_rewards_count_in_single_precision() -> None:
    batch = full()
    batch["next", "reward_components"] = batch["next", "reward_components"].round()
    half = batch.clone()
    half["next", "reward_components"] = half["next", "reward_components"].half()
    expected = losses(batch)
    batch["next", "reward_components"] = batch["next", "reward_components"].long()
    assert torch.equal(losses(batch), expected) and torch.equal(losses(half), expected)


def test_actions_that_are_none_are_refused() -> None:
    beyond, between, rough = torch.full((64,), ACTIONS), torch.full((64,), 0.5), torch.ones(64).half()
    for action, named in ((beyond, f"0 to {ACTIONS - 1}"), (-beyond, "-5"), (between, "float32"), (rough, "float16")):
        with pytest.raises(ValueError, match=named):
            losses(full().set("action", action))


@pytest.mark.parametrize("estimator", [ValueEstimators.TD0, ValueEstimators.TDLambda])
def test_done_terminated_and_truncated_say_each_other(estimator: ValueEstimators) -> None:
    batch = full().exclude("steps_to_next_obs")
    terminated = batch["next", "terminated"]
    truncated = (torch.rand(64, 1) < 0.2) & ~terminated
    batch["next"].update({"truncated": truncated, "done": terminated | truncated})
    torch.manual_seed(0)
    loss = DecomposedDQNLoss(Table(2), components=NAMES)
    loss.make_value_estimator(estimator, gamma=0.9)
    expected = loss(batch)["loss_a"]
    for missing in ("done", "terminated", "truncated"):
        assert torch.equal(loss(batch.exclude(("next", missing)))["loss_a"], expected)
    with pytest.raises(ValueError, match=r"neither 'done' nor 'terminated'"):
        loss(batch.exclude(("next", "done"), ("next", "terminated")))


def test_one_hot_actions_are_those_indices() -> None:
    batch, spec = full(), OneHot(ACTIONS)
    expected = losses(batch)
    with pytest.raises(ValueError, match="action_space='one-hot'"):
        losses(batch.clone().set("action", nn.functional.one_hot(batch["action"], ACTIONS)))
    with pytest.raises(ValueError, match="action_space='categorical'"):
        losses(batch, action_space="one-hot")
    for space in ("one-hot", "one_hot", spec):
        for dtype in (torch.int64, torch.bool, torch.float32):
            batch["action"] = nn.functional.one_hot(full()["action"], ACTIONS).to(dtype)
            assert torch.equal(losses(batch, action_space=space), expected)
    assert torch.equal(losses(full(), action_space=Categorical(ACTIONS)), expected)
    batch["action"] = nn.functional.one_hot(full()["action"], ACTIONS + 1)
    with pytest.raises(ValueError, match=f"{ACTIONS + 1} numbers.*{ACTIONS} actions"):
        losses(batch, action_space=spec)
    with pytest.raises(ValueError, match=r"'categorical'.*'one-hot'"):
        losses(batch, action_space=Binary(ACTIONS))


@pytest.mark.parametrize("names", [["a"], ["b", "a"], ["a", "a"], ["a", "c"], ["a", "b", "c"], [], "ab"])
def test_components_are_the_networks_own(names: Any) -> None:
    with pytest.raises(ValueError, match=r"components=.*\['a', 'b'\]"):
        DecomposedDQNLoss(qmaps(), components=names)
    with pytest.raises(ValueError, match=r"components=.*\['a', 'b'\]"):
        DecomposedDQNLoss(GreedyPolicy(qmaps()), components=names)


@pytest.mark.parametrize("names", [["a"], ["a", "b", "c"]])
def test_another_number_of_maps_than_names_is_refused(names: list[str]) -> None:
    with pytest.raises(ValueError, match=rf"component_action_value \[64, 2, {ACTIONS}\], must be \[64, {len(names)}"):
        make_loss(Table(2), names)(full(components=len(names)))


@pytest.mark.parametrize("setting", ["reduction", "loss_function"])
def test_unknown_settings_are_refused(setting: Any) -> None:
    with pytest.raises(ValueError, match=f"{setting}='median' is not one of"):
        DecomposedDQNLoss(Table(2), components=NAMES, **{setting: "median"})


def test_renamed_keys_reach_the_estimator() -> None:
    batch = full()
    expected = losses(batch)
    torch.manual_seed(0)
    loss = make_loss(Table(2), NAMES)
    loss.set_keys(steps_to_next_obs="steps")
    batch["steps"] = batch.pop("steps_to_next_obs")
    assert torch.equal(loss(batch)["loss_a"], expected[0])


# -- maps ----------------------------------------------------------------------------------------------------------


def scenes(count: int = 4, rows: int = 48, columns: int = 44) -> TensorDict:
    """Transitions between heightmaps; every second one is the last."""
    torch.manual_seed(3)
    over = (torch.arange(count) % 2 == 1)[:, None]
    following = {"heightmap": torch.rand(count, 4, rows, columns), "reward_components": torch.rand(count, 2)}
    state = {"heightmap": torch.rand(count, 4, rows, columns), "action": torch.randint(rows * columns, (count,))}
    return TensorDict({**state, "next": {**following, "done": over, "terminated": over}}, [count])


@pytest.mark.parametrize("network", [Dense, QMaps])
@pytest.mark.parametrize("lead", [(1, 4), (2, 2), (4, 1), (2, 1, 2)])
def test_any_batch_is_the_flat_one(lead: tuple[int, ...], network: type[QMaps]) -> None:
    loss, batch = make_loss(qmaps(network=network), NAMES), scenes()
    shaped = batch.reshape(lead)
    expected, found = loss(batch), loss(shaped)
    assert torch.allclose(expected["loss_a"], found["loss_a"], atol=1e-6)
    assert torch.allclose(batch["td_error"].reshape(lead), shaped["td_error"], atol=1e-5)


def test_returns_run_along_the_last_axis_of_a_batch() -> None:
    torch.manual_seed(0)
    loss, batch = DecomposedDQNLoss(Table(2), components=NAMES), transitions(2).reshape(4, 16)
    loss.make_value_estimator(ValueEstimators.TDLambda, gamma=0.9, lmbda=0.8)
    together = loss._targets(batch)[0]
    assert torch.allclose(together, torch.stack([loss._targets(row)[0] for row in batch]), atol=1e-6)


@pytest.mark.parametrize("network", [Dense, QMaps])
def test_precision_of_module_and_batch_are_free(network: type[QMaps]) -> None:
    torch.manual_seed(0)
    loss, batch = make_loss(qmaps(network=network), NAMES), scenes()
    expected = loss(batch)["loss_a"]
    assert torch.allclose(loss(batch.to(torch.float64))["loss_a"], expected, atol=1e-5)
    half = batch.to(torch.float16).set("action", batch["action"])
    assert torch.allclose(loss(half)["loss_a"], expected, rtol=0.1)
    loss.to(torch.float64)
    for precision in (torch.float32, torch.float64):
        found = loss(batch.to(precision))["loss_a"]
        assert found.dtype == torch.float64
        assert torch.allclose(found, expected.double(), atol=1e-5)
        found.backward()


# -- n steps -------------------------------------------------------------------------------------------------------


def rollout(shape: tuple[int, ...], upright: bool) -> TensorDict:
    """``[*, 12]`` steps of trajectories that end at the steps 4 (terminated) and 8 (truncated)."""
    generator = torch.Generator().manual_seed(2)
    states = torch.randint(STATES, (*shape[:-1], shape[-1] + 1), generator=generator)
    terminated, truncated = (torch.zeros(shape, dtype=torch.bool) for _ in range(2))
    terminated[..., 4], truncated[..., 8] = True, True
    flags = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
    following = {name: flag[..., None] if upright else flag for name, flag in flags.items()}
    following |= {"heightmap": states[..., 1:], "reward_components": torch.rand(*shape, 2, generator=generator)}
    action = torch.randint(ACTIONS, shape, generator=generator)
    return TensorDict({"heightmap": states[..., :-1], "action": action, "next": following}, shape)


def n_step_targets(loss: DecomposedDQNLoss, steps: TensorDict, start: int, most: int, gamma: float) -> Tensor:
    """``[*, K]``: Σ_i γ^i r_i, and γ^n Q̄(s_n, a⁺) unless the episode ended, step by step."""
    values = loss.value_network.values.detach()
    target, discount = torch.zeros(*steps.batch_size[:-1], 2), 1.0
    for t in range(start, start + most):
        target += discount * steps["next", "reward_components"][..., t, :]
        discount *= gamma
        if steps["next", "done"][..., t, :].any():
            break
    if not steps["next", "terminated"][..., t, :].any():
        following = values[steps["next", "heightmap"][..., t]]
        best = following.sum(-2).argmax(-1)
        target += discount * following.gather(-1, best[..., None, None].expand(*best.shape, 2, 1)).squeeze(-1)
    return target


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("lead", [(), (3,)])
def test_n_step_batches_of_a_replay_buffer_have_the_n_step_targets(lead: tuple[int, ...], upright: bool) -> None:
    torch.manual_seed(4)
    loss, steps, most = make_loss(Table(2), NAMES), rollout((*lead, 12), upright), 3
    transform = MultiStepTransform(most, 0.9, reward_keys=["reward_components"], done_keys=["done"])
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(32), transform=transform, batch_size=8)
    buffer.extend(steps)
    made = buffer[:]
    count = made.shape[-1]
    assert count == 12 - most
    plain = rollout((*lead, 12), True)
    expected = torch.stack([n_step_targets(loss, plain, t, most, 0.9) for t in range(count)], -2)
    assert torch.allclose(loss._targets(made)[0], expected, atol=1e-6)
    assert torch.isfinite(loss(buffer.sample())["loss_a"])


def test_n_step_batches_of_a_collector_go_through_the_loss(toy_config: Callable[..., DictConfig]) -> None:
    torch.manual_seed(5)
    policy, multi_step = GreedyPolicy(qmaps()), MultiStep(0.9, 2)
    multi_step.reward_keys, multi_step.done_keys = ["reward_components"], ["done"]
    env, settings = ManiSkillEnv(ToyTask), worker.ENDLESS | {"total_frames": 6}
    collector = Collector(env, policy, frames_per_batch=6, postproc=multi_step, **settings)
    batch = next(iter(collector))
    collector.shutdown()
    rewards, (first, second) = batch["next", "original_reward"], batch["steps_to_next_obs"][:2].tolist()
    assert (first, second) == (2, 1)
    loss = make_loss(policy.qmaps, NAMES)
    targets = loss._targets(batch)[0]
    assert torch.allclose(targets[:2], torch.stack((rewards[0] + 0.9 * rewards[1], rewards[1])))
    assert torch.isfinite(loss(batch)["loss_b"])
