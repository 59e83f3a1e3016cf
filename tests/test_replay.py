"""Storage loses nothing, and a turned transition is still the same transition."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from xqmap.models.symmetry import transform
from xqmap.replay import Replay, augment, pack, unpack


def transition(count: int, rows: int = 8, columns: int = 8) -> TensorDict:
    color = torch.randint(0, 256, (count, 3, rows, columns)).float()
    height = torch.rand(count, 1, rows, columns).half().float()
    heightmap = torch.cat((color, height), 1)
    following = {
        "heightmap": heightmap.flip(0),
        "action_mask": torch.rand(count, rows * columns) < 0.5,
        "reward": torch.rand(count, 1),
        "reward_components": torch.rand(count, 2),
        "done": torch.zeros(count, 1, dtype=torch.bool),
        "terminated": torch.zeros(count, 1, dtype=torch.bool),
    }
    action = torch.randint(rows * columns, (count,))
    return TensorDict({"heightmap": heightmap, "action": action, "next": following}, batch_size=[count])


def test_packing_is_exact_for_what_the_environment_gives() -> None:
    heightmap = transition(3)["heightmap"]
    assert torch.equal(unpack(pack(heightmap)), heightmap)
    assert sum(part.nbytes for part in pack(heightmap).values()) == 3 * 5 * 64


def test_grasping_sized_transition_without_bootstrapping_is_small() -> None:
    replay = Replay(capacity=2, batch_size=1, augment=False, next_states=False, seed=0)
    replay.extend(transition(1, 320, 160))
    assert sum(value.nbytes for value in replay.contents().values()) <= 300_000


@pytest.mark.parametrize(("rows", "columns", "elements"), [(8, 8, 8), (8, 4, 4)])
def test_augmentation_moves_map_action_and_mask_together(rows: int, columns: int, elements: int) -> None:
    count = 200
    batch = transition(count, rows, columns)
    # The chosen cell is marked in the map, and the mask allows exactly the marked cell of the next one.
    marked = torch.zeros(count, rows * columns)
    marked[torch.arange(count), batch["action"]] = 1
    batch["heightmap"][:, 3] = marked.view(count, rows, columns)
    batch["next", "heightmap"] = batch["heightmap"].clone()
    batch["next", "action_mask"] = marked.bool()
    before = batch["action"].clone()
    after = augment(batch, torch.Generator().manual_seed(0))
    cells = after["heightmap"][:, 3].reshape(count, -1)
    assert torch.equal(cells.argmax(-1), after["action"])
    assert torch.equal(after["next", "action_mask"], cells.bool())
    assert 0.5 < float((after["action"] != before).float().mean()) < 1.0
    cell = torch.arange(rows * columns).view(rows, columns)
    assert len({tuple(transform(cell, element).flatten().tolist()) for element in range(elements)}) == elements


def test_on_disk_is_as_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    stored, buffers = transition(6), [Replay(8, 4, True, True, seed=1, on_disk=on_disk) for on_disk in (False, True)]
    for replay in buffers:
        replay.extend(stored)
    memory, disk = (replay.sample() for replay in buffers)
    assert all(torch.equal(memory[key], disk[key]) for key in ("heightmap", "action", ("next", "heightmap")))
    again = Replay(8, 4, True, True, seed=1, on_disk=True)
    again.restore(buffers[1].contents(), buffers[1].cursor)
    assert all(torch.equal(value, again.contents()[name]) for name, value in buffers[0].contents().items())


def test_sampling_repeats_by_seed_and_survives_a_restore() -> None:
    stored = transition(6)
    first = Replay(capacity=4, batch_size=3, augment=True, next_states=True, seed=1)
    first.extend(stored[:3]), first.extend(stored[3:])
    second = Replay(capacity=4, batch_size=3, augment=True, next_states=True, seed=2)
    second.restore(first.contents(), first.cursor)
    second.generator.set_state(first.generator.get_state())
    for extra in (transition(1), transition(2)):
        a, b = first.sample(), second.sample()
        assert all(torch.equal(a[key], b[key]) for key in ("heightmap", "action", ("next", "heightmap"), ("next", "reward")))
        first.extend(extra), second.extend(extra)
    assert first.cursor == second.cursor
