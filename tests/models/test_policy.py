"""One argmax of the weighted sum, values that belong to the action, and exploration that stays where it may."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from xqmap.benchmarks.references import plain_unet
from xqmap.data.symmetry import elements, restore, transform
from xqmap.models.policy import EpsilonGreedy, GreedyPolicy, masked_argmax, random_action
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import LocalGeometry, UNet


def qmaps(weights: Mapping[str, float] | Sequence[float] | None = None) -> QMaps:
    torch.manual_seed(0)
    return QMaps(["a", "b"], LocalGeometry(0.25, 1.0, [3, 5], 9, 5.0), lambda c: UNet(c, 4, 2), weights)


def scene(count: int = 2, rows: int = 18, columns: int = 22) -> TensorDict:
    mask = torch.rand(count, rows * columns) < 0.3
    return TensorDict({"heightmap": torch.rand(count, 4, rows, columns), "action_mask": mask}, batch_size=[count])


def test_any_size_gives_maps_of_that_size() -> None:
    for rows, columns in [(18, 22), (84, 84), (33, 47)]:
        out = GreedyPolicy(qmaps())(scene(1, rows, columns))
        assert out["component_action_value"].shape == (1, 2, rows * columns)


@pytest.mark.parametrize(("rows", "columns"), [(20, 20), (20, 28)])
def test_a_symmetric_agent_turns_its_maps_with_the_scene_but_learns_as_any_other(rows: int, columns: int) -> None:
    network = qmaps()
    image = torch.rand(1, 4, rows, columns)
    one_sided = network.maps(image)
    network.symmetric = True
    assert torch.equal(network.maps(image), one_sided), "in training nothing is averaged"
    maps = network.eval().maps(image)
    assert not torch.allclose(maps, one_sided, atol=1e-3)
    for side in range(elements(rows, columns)):
        assert torch.allclose(network.maps(transform(image, side)), transform(maps, side), atol=1e-5)
        assert torch.equal(restore(transform(image, side), side), image)


def test_the_sum_is_weighted_and_the_values_are_those_at_the_action() -> None:
    out = GreedyPolicy(qmaps([2.0, 0.5]))(scene())
    maps = out["component_action_value"]
    assert torch.allclose(out["action_value"], 2.0 * maps[:, 0] + 0.5 * maps[:, 1])
    assert torch.equal(out["action"], masked_argmax(out["action_value"], out["action_mask"]))
    rows = torch.arange(2)
    assert torch.equal(out["chosen_component_value"], maps[rows, :, out["action"]])
    assert torch.equal(out["chosen_action_value"][:, 0], out["action_value"][rows, out["action"]])


def test_weights_are_taken_by_name_and_others_are_refused() -> None:
    assert torch.equal(qmaps({"b": 0.5, "a": 2.0}).weights, torch.tensor([2.0, 0.5]))
    for weights in ({"a": 1.0}, {"a": 1.0, "c": 1.0}, {"a": 1.0, "b": 1.0, "c": 1.0}, [1.0], [1.0, 1.0, 1.0]):
        with pytest.raises(ValueError, match=r"components.*'a', 'b'"):
            qmaps(weights)


def test_a_policy_reads_what_its_network_reads() -> None:
    class Wide(TensorDictModuleBase):
        in_keys, out_keys = ("observation",), ("component_action_value", "action_value")

        def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
            values = tensordict["observation"]
            return tensordict.update({"component_action_value": values[..., None, :], "action_value": values})

    policy = GreedyPolicy(Wide())
    assert policy.in_keys == ["observation"]
    assert policy(TensorDict({"observation": torch.tensor([[0.0, 2.0, 1.0]])}, [1]))["action"].item() == 1


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_maps_have_the_precision_of_the_network_whatever_the_heightmap_has(dtype: torch.dtype) -> None:
    network, image = qmaps(), scene()["heightmap"].to(dtype)
    expected = network.maps(image.float())
    assert network.maps(image).dtype == torch.float32
    assert torch.allclose(network.maps(image), expected, atol=1e-5)
    assert network.double().maps(image).dtype == torch.float64
    assert torch.allclose(network.maps(image), expected.double(), atol=1e-5)


def test_mask_is_obeyed_unless_it_allows_nothing() -> None:
    values = torch.tensor([[3.0, 2.0, 1.0]])
    for kind in (torch.bool, torch.uint8, torch.float32):
        assert masked_argmax(values, torch.tensor([[False, True, True]]).to(kind)).item() == 1
    assert masked_argmax(values, torch.zeros(1, 3, dtype=torch.bool)).item() == 0


def test_exploration_follows_its_schedule_and_counts() -> None:
    explore = EpsilonGreedy(1.0, 0.0, 10, 0.0, 0.1, seed=0)
    assert explore.eps == 1.0
    td = GreedyPolicy(qmaps())(scene(1))
    greedy = td["action"].clone()
    for _ in range(10):
        explore(td)
    assert explore.eps == 0.0
    td["action"] = greedy.clone()
    assert torch.equal(explore(td)["action"], greedy)


def test_random_actions_keep_to_the_mask_and_to_raised_cells() -> None:
    generator = torch.Generator().manual_seed(0)
    height = torch.tensor([0.0, 0.5, 0.5, 0.0])
    allowed = torch.tensor([True, True, False, True])
    assert {int(random_action(height, allowed, None, generator)) for _ in range(100)} == {0, 1, 3}
    assert {int(random_action(height, allowed, 0.1, generator)) for _ in range(20)} == {1}
    assert {int(random_action(height, ~height.bool(), 0.9, generator)) for _ in range(50)} == {0, 3}


def test_stem_measures_slope_and_ignores_turns() -> None:
    stem = LocalGeometry(0.25, 1.0, [3, 5], 9, 5.0)
    rise = torch.arange(40.0) * 0.25 * torch.tan(torch.deg2rad(torch.tensor(8.0)))
    image = torch.zeros(1, 4, 40, 40)
    image[0, 3] = 3.0 + rise
    features = stem(image)
    assert torch.allclose(features[0, [5, 7], 20, 20] * 5.0, torch.tensor([8.0, 8.0]), atol=0.01)
    assert float(features[0, [6, 8], 20, 20].max()) < 0.05
    turned = stem(image.transpose(-1, -2))
    assert torch.allclose(turned, features.transpose(-1, -2), atol=1e-2)


def test_doubled_cells_are_never_built_and_give_the_same_maps_and_gradients() -> None:
    torch.manual_seed(0)
    net, image = UNet(9, 8, 2), torch.rand(2, 9, 24, 20)

    (expected, expected_gradients), (maps, gradients) = (
        (out, torch.autograd.grad(out.square().sum(), list(net.parameters())))
        for out in (plain_unet(net, image), net(image))
    )
    assert torch.allclose(expected, maps, atol=1e-6)
    assert all(torch.allclose(a, b, rtol=1e-4, atol=1e-5) for a, b in zip(expected_gradients, gradients, strict=True))


def test_maps_drawn_one_after_the_other_are_those_drawn_together(monkeypatch: pytest.MonkeyPatch) -> None:
    network, image = qmaps(), torch.rand(5, 4, 18, 22)
    together = network.maps(image)
    monkeypatch.setattr("xqmap.models.qmaps._CELLS_IN_CACHE", 1)
    with torch.no_grad():
        assert torch.allclose(network.maps(image), together, atol=1e-6)


@pytest.mark.skipif(not torch.cpu._is_avx512_bf16_supported(), reason="this processor has no bfloat16 to measure")
def test_reduced_precision_seldom_changes_the_choice_and_never_by_much() -> None:
    """Of untrained maps, whose cells are much more alike than a trained agent's."""
    torch.manual_seed(0)
    network, image = qmaps(), torch.rand(32, 4, 32, 32)
    with torch.no_grad():
        exact = network(TensorDict({"heightmap": image}, [32]))["action_value"]
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        rough = network(TensorDict({"heightmap": image}, [32]))["action_value"]
    lost = exact.max(-1).values - exact.gather(-1, rough.argmax(-1, keepdim=True))[:, 0]
    spread = exact.std(-1)
    assert not torch.equal(rough, exact)
    assert float((lost > 0).float().mean()) <= 0.5
    assert float((lost / spread).max()) < 0.2
