"""Values and gradients on the cells that count against those of the whole map: everywhere on it, and however the
network is built.
"""

from __future__ import annotations

import copy

import pytest
import torch
from torch import Tensor, nn

from tests.objectives.test_decomposed_dqn import Dense, qmaps
from xqmap.models.qmaps import QMaps, values_at
from xqmap.models.unet import UNet
from xqmap.objectives import cone


def everywhere(rows: int, columns: int) -> Tensor:
    """Cells in every corner, along every border, around the middle, and at each place of the pooling grid there."""
    down, across = ([0, 1, 2, *range(n // 2, n // 2 + 8), n - 3, n - 2, n - 1] for n in (rows, columns))
    return torch.tensor([row * columns + column for row in down for column in across])[::3]


def views(network: QMaps, rows: int, columns: int, count: int) -> Tensor:
    scale = torch.tensor([255.0, 255, 255, 2]).view(4, 1, 1)
    return torch.rand(count, 4, rows, columns).to(network.weights.dtype) * scale.to(network.weights.dtype)


def both(network: QMaps, image: Tensor, action: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """Values and gradients, of the whole map and of cones."""
    found = []
    for values in (values_at(network.maps(image).flatten(2), action), cone.values(network, image, action)):
        gradients = torch.autograd.grad(values.square().sum(), list(network.parameters()))
        found.append([values.detach(), *gradients])
    return found[0], found[1]


def assert_same(network: QMaps, rows: int, columns: int) -> None:
    action = everywhere(rows, columns)
    dense, ours = both(network, views(network, rows, columns, len(action)), action)
    assert all(float((a - b).norm()) <= 1e-5 * float(a.norm()) for a, b in zip(dense, ours, strict=True))
    assert all(bool(a.any()) for a in dense)


def size(network: QMaps, rows: int, columns: int) -> int:
    """Edge of what the first layer reads."""
    first = network.unets[0]
    assert isinstance(first, UNet)
    return cone.Cone(first, torch.zeros(1, 2, dtype=torch.int64), (rows, columns)).base.size


@pytest.mark.parametrize(
    ("rows", "columns", "depth"),
    [(84, 84, 2), (64, 100, 1), (101, 90, 2), (46, 47, 2), (108, 110, 3), (24, 30, 0), (16, 19, 0), (40, 60, 2)],
)
def test_values_and_gradients_are_the_whole_maps(rows: int, columns: int, depth: int) -> None:
    torch.manual_seed(0)
    network = qmaps(8, depth)
    assert size(network, rows, columns) ** 2 < rows * columns
    assert_same(network, rows, columns)


def test_a_map_smaller_than_the_cone_is_computed_whole() -> None:
    torch.manual_seed(1)
    network = qmaps(8)
    assert size(network, 20, 20) > 20
    assert_same(network, 20, 20)


def test_regions_are_computed_from_the_layers_that_are_there() -> None:
    torch.manual_seed(2)
    network = qmaps(8, 1)
    narrow = size(network, 64, 64)
    for unet in network.unets:
        assert isinstance(unet, UNet)
        unet.encoder[0][2] = nn.Conv2d(8, 8, 5, padding=2)
        unet.encoder[1][0] = nn.Conv2d(8, 16, 1)
        unet.decoder[0].extend([nn.Conv2d(8, 8, 7, padding=3), nn.ReLU()])
    assert cone.has_cone(network)
    assert size(network, 64, 64) != narrow
    assert_same(network, 64, 64)


@pytest.mark.parametrize(("rows", "columns"), [(50, 50), (50, 60)])
def test_the_mean_over_all_sides_is_the_whole_maps(rows: int, columns: int) -> None:
    torch.manual_seed(3)
    network = qmaps(8)
    network.symmetric = True
    network.eval()
    assert_same(network, rows, columns)


def test_double_precision() -> None:
    torch.manual_seed(4)
    network, action = qmaps().double(), everywhere(50, 60)
    dense, ours = both(network, views(network, 50, 60, len(action)), action)
    assert all(torch.allclose(a, b, atol=1e-13) for a, b in zip(dense, ours, strict=True))


def test_bfloat16_stays_as_near_as_it_is() -> None:
    torch.manual_seed(5)
    network, action = qmaps(width=16), everywhere(50, 60)
    image = views(network, 50, 60, len(action))
    exact = cone.values(network, image, action).detach()
    with torch.autocast("cpu", torch.bfloat16):
        dense, ours = both(network, image, action)
    error = float((dense[0] - exact).abs().mean())
    assert 0 < float((ours[0] - exact).abs().mean()) < 1.5 * error
    for a, b in zip(dense[1:], ours[1:], strict=True):
        assert float((a - b).norm()) < 0.05 * float(a.norm())


@pytest.mark.parametrize("depth", [0, 1, 2, 3])
def test_the_cone_is_what_the_gradient_reaches(depth: int) -> None:
    """No cell too few, and no more than the pooling grid asks for."""
    torch.manual_seed(6)
    network = qmaps(8, depth)
    edge = 16 * 2**depth
    first, widest = network.unets[0], 0
    assert isinstance(first, UNet)
    for row in range(edge // 2, edge // 2 + network.stride):
        image = torch.rand(1, 4, edge, edge, requires_grad=True)
        features = network.stem(image)
        value = torch.cat([unet(features) for unet in network.unets], 1)[0, :, row, row].sum()
        touched = torch.autograd.grad(value, image)[0].abs().sum((0, 1, 3)).nonzero()
        start, end = int(touched.min()), int(touched.max())
        base = cone.Cone(first, torch.tensor([[row, row]]), (edge, edge)).base.grown(network.stem.radius)
        assert int(base.start[0, 0]) <= start
        assert end < int(base.start[0, 0]) + base.size
        widest = max(widest, end - start + 1)
    assert widest <= base.size <= widest + network.stride


def test_what_cones_would_get_wrong_is_left_to_the_whole_map() -> None:
    plain = qmaps()
    assert cone.has_cone(plain)
    assert not cone.has_cone(qmaps(network=Dense))
    assert not cone.has_cone(nn.Conv2d(4, 2, 3, padding=1))
    for unfit in (
        nn.Sequential(nn.Conv2d(4, 4, 3, padding=1), nn.GroupNorm(1, 4)),
        nn.Sequential(nn.Conv2d(4, 4, 3, padding=1, padding_mode="circular"), nn.ReLU()),
        nn.Sequential(nn.Conv2d(4, 4, 3, padding=2, dilation=2), nn.ReLU()),
        nn.Sequential(nn.Conv2d(4, 4, 3, padding=1), nn.Sigmoid()),
        nn.Sequential(nn.Conv2d(4, 4, 3, padding="same"), nn.ReLU()),
        nn.Sequential(nn.Conv2d(4, 4, (1, 3), padding=1), nn.ReLU()),
    ):
        network = copy.deepcopy(plain)
        for unet in network.unets:
            assert isinstance(unet, UNet)
            unet.encoder[0] = unfit
        assert not cone.has_cone(network)
    network = copy.deepcopy(plain)
    network.unets[1] = UNet(network.stem.channels, 4, 1)
    assert not cone.has_cone(network)
