"""What is kept of next states is what would be computed, and is gone when it would not be any more; a choice that is
kept longer is the one that was made, turned with its map.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor

from tests.objectives.test_decomposed_dqn import between_maps, make_loss, qmaps
from xqmap.data.replay import Replay
from xqmap.data.symmetry import moved
from xqmap.models.qmaps import QMaps
from xqmap.objectives import DecomposedDQNLoss
from xqmap.objectives.kept import Kept

ROWS, COLUMNS = 12, 16


def replay(augment: bool = True, edges: tuple[int, int] = (ROWS, COLUMNS), capacity: int = 8) -> Replay:
    made = between_maps(*edges, torch.randint(edges[0] * edges[1], (6,)))
    made["next", "heightmap"], made["heightmap"] = made["next", "heightmap"].half().float(), made["heightmap"].half()
    for state in (made, made["next"]):
        state["action_mask"] = torch.rand(6, edges[0] * edges[1]) < 0.5
    made["next", "terminated"] = made["next", "done"] = (torch.arange(6) == 4)[:, None]
    made["next", "reward"] = made["next", "reward_components"].sum(-1, keepdim=True)
    memory = Replay(capacity, 8, augment, next_states=True, seed=0)
    memory.extend(made)
    return memory


class Counted(QMaps):
    """Counts the maps it draws, by what they show."""

    drawn: Counter[float]

    def maps(self, heightmap: Tensor) -> Tensor:
        self.drawn.update(float(image.double().sum()) for image in heightmap)
        return super().maps(heightmap)


def losses(settings: dict[str, Any], kept: Kept | None) -> DecomposedDQNLoss:
    torch.manual_seed(1)
    loss = make_loss(qmaps(), ["a", "b"], kept=kept, **settings)
    loss.target_value_network_params.apply(lambda p: p.data.mul_(1.1))
    return loss


def change(params: Any) -> None:
    generator = torch.Generator().manual_seed(2)
    params.apply(lambda p: p.data.mul_(1 + 0.2 * torch.rand(p.shape, generator=generator)))


@pytest.mark.parametrize("settings", [{}, {"double_dqn": False}, {"shared_argmax": False}])
@pytest.mark.parametrize("augment", [False, True])
def test_targets_are_those_of_nothing_kept(settings: dict[str, Any], augment: bool) -> None:
    torch.manual_seed(0)
    memory, kept = replay(augment), Kept()
    keeping, plain = losses(settings, kept), losses(settings, None)
    for update in range(12):
        batch = memory.sample()
        assert torch.allclose(keeping._targets(batch)[0], plain._targets(batch)[0], atol=1e-6)
        for loss in (keeping, plain):
            change(loss.value_network_params)
            if update % 4 == 3:
                change(loss.target_value_network_params)
        kept.step(moved=update % 4 == 3)


@pytest.mark.parametrize("settings", [{"double_dqn": False}, {"shared_argmax": False}])
def test_the_target_nets_see_a_state_once_a_period(settings: dict[str, Any]) -> None:
    torch.manual_seed(0)
    memory, kept = replay(), Kept()
    network = qmaps(network=Counted)
    assert isinstance(network, Counted)
    network.drawn = Counter()
    loss = make_loss(network, ["a", "b"], kept=kept, **settings)
    for period in range(1, 3):
        seen = set()
        for _ in range(6):
            batch = memory.sample()
            loss._targets(batch)[0]
            kept.step(moved=False)
            goes_on = ~batch["next", "terminated"].squeeze(-1)
            seen |= {float(image.double().sum()) for image in batch["next", "heightmap"][goes_on]}
        # Sums tell the states apart, and not the sides: each state is seen from four.
        assert set(network.drawn) == seen
        assert max(network.drawn.values()) <= 4 * period + (period - 1) * 8
        before = sum(network.drawn.values())
        loss._targets(batch)[0]
        assert sum(network.drawn.values()) == before
        kept.step(moved=True)


def test_what_is_overwritten_is_forgotten() -> None:
    torch.manual_seed(0)
    kept, memory = Kept(choice_period=10), replay(augment=False)
    keeping, plain = losses({}, kept), losses({}, None)
    batch = memory.sample()
    keeping._targets(batch)[0]
    other = replay(augment=False).buffer[:]
    fresh = between_maps(ROWS, COLUMNS, torch.randint(ROWS * COLUMNS, (6,)))
    fresh["next", "reward"] = fresh["next", "reward_components"].sum(-1, keepdim=True)
    for state in (fresh, fresh["next"]):
        state["heightmap"] = state["heightmap"].half().float()
        state["action_mask"] = torch.ones(6, ROWS * COLUMNS, dtype=torch.bool)
    assert len(other) == 6
    places = memory.extend(fresh)
    assert places == [6, 7, 0, 1, 2, 3]
    kept.forget(places)
    batch = memory.sample()
    assert torch.allclose(keeping._targets(batch)[0], plain._targets(batch)[0], atol=1e-6)


@pytest.mark.parametrize("edges", [(16, 16), (12, 16)])
def test_a_kept_choice_turns_with_its_map_for_so_many_updates(edges: tuple[int, int]) -> None:
    kept, sides = Kept(choice_period=3), len(moved(*edges))
    places, cells = torch.tensor([5, 9]), torch.tensor([3, 40])
    for made_from in range(sides):
        at = torch.full((2,), made_from)
        kept.choose(places, at, edges, moved(*edges)[at, cells])
        for seen_from in range(sides):
            now = torch.full((2,), seen_from)
            assert torch.equal(kept.choices(places, now, edges), moved(*edges)[now, cells])
    for _ in range(2):
        kept.step(moved=True)
        assert kept.choices(torch.tensor([5, 7]), torch.tensor([0, 0]), edges).tolist() == [3, -1]
    kept.step(moved=False)
    assert kept.choices(places, torch.tensor([0, 0]), edges).tolist() == [-1, -1]


def test_a_kept_choice_is_valued_by_the_target_nets_of_now() -> None:
    torch.manual_seed(0)
    memory, kept = replay(augment=False), Kept(choice_period=5)
    loss = losses({}, kept)
    batch = memory.sample()
    first = _future(loss, batch)
    choice = kept.choices(batch["index"], batch["side"], (ROWS, COLUMNS))
    assert int((choice >= 0).sum()) > 0
    change(loss.value_network_params)
    kept.step(moved=False)
    assert torch.equal(_future(loss, batch), first)
    change(loss.target_value_network_params)
    kept.step(moved=True)
    goes_on = ~batch["next", "terminated"].squeeze(-1)
    valued = loss.value_network.joined(  # type: ignore[operator]
        *loss._parts(batch["next"], choice.clamp_min(0), loss.target_value_network_params)
    )
    now = _future(loss, batch)
    assert torch.allclose(now[goes_on], 0.9 * valued[goes_on], atol=1e-6)
    assert not torch.allclose(now, first)


def _future(loss: DecomposedDQNLoss, batch: TensorDictBase) -> Tensor:
    with torch.no_grad():
        return loss._targets(batch)[0] - batch["next", "reward_components"]


def test_a_period_of_one_keeps_no_choice() -> None:
    kept, places = Kept(), torch.tensor([1, 2])
    kept.choose(places, places, (ROWS, COLUMNS), places)
    assert kept.choices(places, places, (ROWS, COLUMNS)).tolist() == [-1, -1]
    assert kept.state_dict().keys() == {"updates"}


def test_what_is_kept_survives_a_checkpoint() -> None:
    torch.manual_seed(0)
    memory, kept = replay(), Kept(choice_period=4)
    loss = losses({}, kept)
    for _ in range(3):
        batch = memory.sample()
        loss._targets(batch)[0]
        kept.step(moved=False)
    again = Kept(choice_period=4)
    again.load_state_dict(kept.state_dict())
    assert {name: value.tolist() for name, value in again.state_dict().items()} == {
        name: value.tolist() for name, value in kept.state_dict().items()
    }
    state = batch["index"], batch["side"]
    choice = kept.choices(*state, (ROWS, COLUMNS))
    assert torch.equal(again.choices(*state, (ROWS, COLUMNS)), choice)
    assert torch.equal(again.unknown(*state, choice), kept.unknown(*state, choice))
    known = [part[choice >= 0] for part in (*state, choice)]
    assert torch.equal(again.values(*known), kept.values(*known))


def test_where_nothing_is_kept_a_batch_needs_no_place() -> None:
    torch.manual_seed(0)
    batch = replay().sample()
    expected = losses({}, None)(batch.clone())["loss_a"]
    assert torch.equal(losses({}, None)(batch.exclude("index", "side"))["loss_a"], expected)
