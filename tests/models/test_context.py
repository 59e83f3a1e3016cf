"""What else lies on the map: counted exactly, gating what follows, and learned apart from what a decision pays."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from tests.objectives.test_cone import assert_same, everywhere, views
from xqmap.evaluation.baselines import greedy, out_of_context
from xqmap.models.context import Context
from xqmap.models.policy import GreedyPolicy
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import LocalGeometry, UNet
from xqmap.objectives import DecomposedDQNLoss, cone

GAMMA = 0.9


def split(depth: int = 1, symmetric: bool = False, horizon: int = 0) -> QMaps:
    stem = LocalGeometry(0.25, 1.0, [3, 5], 9, 5.0)
    context = Context(8, 1.0, 0.5)
    return QMaps(
        ("a", "b"), stem, lambda n: UNet(n, 4, depth, context=8, horizon=horizon), None, symmetric, context, GAMMA
    )


@pytest.mark.parametrize(("rows", "columns", "depth"), [(64, 60, 1), (47, 50, 2), (24, 30, 0), (20, 20, 2)])
@pytest.mark.parametrize("symmetric", [False, True])
def test_values_and_gradients_in_context_are_the_whole_maps(
    rows: int, columns: int, depth: int, symmetric: bool
) -> None:
    torch.manual_seed(0)
    network = split(depth, symmetric)
    assert_same(network.eval() if symmetric else network, rows, columns)


def test_a_bare_map_adds_nothing_and_objects_add_up() -> None:
    torch.manual_seed(1)
    context = Context(8, 1.0, 0.5)
    bare = torch.rand(1, 4, 64, 64) * torch.tensor([255.0, 255, 255, 0.4]).view(4, 1, 1)
    nothing = context.numbers(torch.zeros(1, 64)).relu()
    assert torch.allclose(context(bare), nothing)
    assert torch.allclose(context(torch.nn.functional.pad(bare, (0, 40, 0, 24))), nothing)
    first, second, both = bare.clone(), bare.clone(), bare.clone()
    for image, at in ((first, 8), (second, 40), (both, 8), (both, 40)):
        image[..., at : at + 8, at : at + 8] = torch.tensor([200.0, 20, 20, 1.0]).view(4, 1, 1)
    sums = [context.convolutions(seen(context, image)).sum((2, 3)) for image in (first, second, both)]
    assert torch.allclose(sums[0] + sums[1], sums[2], atol=1e-4)
    assert not torch.allclose(context(both), context(first))


def seen(context: Context, image: Tensor) -> Tensor:
    """What the convolutions get, of colors about the middle and heights that stand up."""
    scaled = torch.cat((image[:, :3] / 127.5 - 1, image[:, 3:] / context.height_scale), 1)
    return torch.nn.functional.avg_pool2d(scaled * (image[:, 3:] > context.raised_height), 2)


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("horizon", [0, 3])
def test_now_and_later_are_the_value(symmetric: bool, horizon: int) -> None:
    torch.manual_seed(2)
    network = split(symmetric=symmetric, horizon=horizon).eval()
    image, action = views(network, 40, 48, 3), torch.tensor([0, 1000, 1919])
    now, later = cone.parts(network, image, action)
    assert later is not None
    with torch.no_grad():
        maps, parts = network.maps(image).flatten(2), network.parts(image).flatten(3)
    rows = torch.arange(3)
    assert torch.allclose(maps[rows, :, action], now + GAMMA * later.sum(-1), atol=1e-5)
    assert torch.allclose(parts.sum(2), maps, atol=1e-5)
    assert torch.allclose(parts[rows, :, 0, action], now, atol=1e-5)
    assert torch.allclose(parts[rows, :, 1:, action], GAMMA * later, atol=1e-5)


def test_what_is_paid_does_not_depend_on_what_lies_elsewhere_and_what_follows_does() -> None:
    torch.manual_seed(3)
    network = split()
    image = views(network, 64, 64, 1)
    other = image.clone()
    other[..., 40:, 40:] = 0
    action = torch.tensor([5 * 64 + 5])
    (now, later), (now_too, later_too) = (cone.parts(network, x, action) for x in (image, other))
    assert later is not None and later_too is not None
    assert torch.equal(now, now_too) and not torch.allclose(later, later_too)


def test_out_of_context_the_context_is_all_zeros_and_the_policy_stays_as_it_was() -> None:
    torch.manual_seed(6)
    policy = GreedyPolicy(split()).eval()
    torch.nn.init.normal_(policy.qmaps.context.numbers.bias, std=20.0)
    image = views(policy.qmaps, 40, 48, 8)
    states = [TensorDict({"heightmap": each, "action_mask": torch.ones(40 * 48, dtype=torch.bool)}) for each in image]
    own, blind = greedy(policy), out_of_context(policy)
    chosen = [[choose(state, None, None) for state in states] for choose in (own, blind, own)]  # type: ignore[arg-type]
    assert chosen[0] == chosen[2] != chosen[1]
    policy.qmaps.context.forward = lambda heightmap: torch.zeros(len(heightmap), 8)
    assert [own(state, None, None) for state in states] == chosen[1]  # type: ignore[arg-type]


def batch(network: QMaps, count: int = 6) -> TensorDict:
    ends = torch.arange(count)[:, None] % 2 == 0
    following = {
        "heightmap": views(network, 40, 40, count),
        "reward_components": torch.rand(count, 2),
        "done": ends,
        "terminated": ends,
    }
    state = {"heightmap": views(network, 40, 40, count), "action": everywhere(40, 40)[:count], "next": following}
    return TensorDict(state, batch_size=[count])


def test_each_part_learns_its_own() -> None:
    torch.manual_seed(4)
    network = split()
    loss = DecomposedDQNLoss(network, components=("a", "b"), loss_function="l2")
    loss.make_value_estimator(gamma=GAMMA)
    data = batch(network)
    found = loss(data.clone())
    now, later = cone.parts(network, data["heightmap"], data["action"])
    assert later is not None
    following = data["next", "heightmap"]
    with torch.no_grad():
        best = (network.maps(following).flatten(2) * network.weights[:, None]).sum(1).argmax(-1)
        future = network.maps(following).flatten(2)[torch.arange(6), :, best] * ~data["next", "terminated"]
    reward = data["next", "reward_components"]
    expected = (now - reward).square().mean(0) + (later[..., 0] - future).square().mean(0)
    assert torch.allclose(torch.stack([found["loss_a"], found["loss_b"]]), expected, atol=1e-5)
    error = (now + GAMMA * later[..., 0] - reward - GAMMA * future).abs().mean(0)
    assert torch.allclose(torch.stack([found["td_error_a"], found["td_error_b"]]), error, atol=1e-5)


@pytest.mark.parametrize("shared", [True, False])
def test_each_horizon_learns_what_the_one_before_it_says_a_decision_later(shared: bool) -> None:
    torch.manual_seed(5)
    network = split(horizon=2)
    loss = DecomposedDQNLoss(network, components=("a", "b"), loss_function="l2", shared_argmax=shared)
    loss.make_value_estimator(gamma=GAMMA)
    data = batch(network)
    found = loss(data.clone())
    now, later = cone.parts(network, data["heightmap"], data["action"])
    assert later is not None and later.shape == (6, 2, 3)
    reward, goes_on = data["next", "reward_components"], ~data["next", "terminated"]
    with torch.no_grad():
        maps = network.maps(data["next", "heightmap"]).flatten(2)
        parts = network.parts(data["next", "heightmap"]).flatten(3)
    best = maps.sum(1, keepdim=True).argmax(-1).expand(-1, 2) if shared else maps.argmax(-1)
    ahead = parts.gather(-1, best[..., None, None].expand(-1, -1, 4, -1)).squeeze(-1) * goes_on[..., None]
    expected = torch.stack((ahead[..., 0], ahead[..., 1], ahead[..., 2] + ahead[..., 3]), -1)
    future = maps.gather(-1, best[..., None]).squeeze(-1) * goes_on
    assert torch.allclose(expected.sum(-1), future, atol=1e-5)
    each = (later - expected)[..., :-1].square().sum(-1) + (later.sum(-1) - future).square() + (now - reward).square()
    assert torch.allclose(torch.stack([found["loss_a"], found["loss_b"]]), each.mean(0), atol=1e-5)


def test_telling_apart_changes_nothing_of_what_is_learned_as_a_whole() -> None:
    gradients = []
    for horizon in (0, 3):
        torch.manual_seed(7)
        network = split(horizon=horizon)
        state = {
            name: torch.sin(torch.arange(t.numel()).view_as(t) + len(name)) / 9
            for name, t in network.state_dict().items()
        }
        network.load_state_dict(state)
        loss = DecomposedDQNLoss(network, components=("a", "b"))
        loss.make_value_estimator(gamma=GAMMA)
        torch.manual_seed(8)
        found = loss(batch(network))
        (found["loss_a"] + found["loss_b"]).backward()
        gradients.append({n: p.grad for n, p in loss.named_parameters() if p.requires_grad})
    whole, apart = gradients
    assert set(apart) - set(whole) == {name for name in apart if ".ahead." in name.replace("_", ".")}
    assert all(torch.allclose(apart[name], gradient, atol=1e-6) for name, gradient in whole.items())
    assert any(bool(gradient.any()) for name, gradient in apart.items() if name not in whole)


def test_what_does_not_go_together_is_refused() -> None:
    network = split()
    loss = DecomposedDQNLoss(network, components=("a", "b"))
    with pytest.raises(ValueError, match=r"gamma=0\.5"):
        loss.make_value_estimator(gamma=0.5)
    loss.make_value_estimator(gamma=GAMMA)
    with pytest.raises(ValueError, match="steps_to_next_obs"):
        loss(batch(network).set("steps_to_next_obs", torch.full((6,), 3)))
