"""Storage loses nothing though every state is there once, and a turned transition is still the same transition."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from xqmap.data.replay import Replay, augment, pack, unpack
from xqmap.data.samplers import PrioritySampler
from xqmap.data.symmetry import transform

STATE = ("heightmap", "action_mask")


def states(count: int, rows: int = 8, columns: int = 8) -> TensorDict:
    color = torch.randint(0, 256, (count, 3, rows, columns)).float()
    height = torch.rand(count, 1, rows, columns).half().float()
    return TensorDict(
        {"heightmap": torch.cat((color, height), 1), "action_mask": torch.rand(count, rows * columns) < 0.5}, [count]
    )


def episode(steps: int, rows: int = 8, columns: int = 8, terminated: bool = True) -> TensorDict:
    """``[steps]`` transitions, each from where the one before led to."""
    seen = states(steps + 1, rows, columns)
    over = torch.zeros(steps, 1, dtype=torch.bool)
    over[-1] = True
    following = seen[1:].clone().update({"reward": torch.rand(steps, 1), "reward_components": torch.rand(steps, 2)})
    following.update({"done": over, "terminated": over & terminated})
    return seen[:-1].clone().update({"action": torch.randint(rows * columns, (steps,)), "next": following})


def replay(capacity: int = 8, batch_size: int = 4, **settings: Any) -> Replay:
    return Replay(
        **{"capacity": capacity, "batch_size": batch_size, "augment": False, "next_states": True, "seed": 1, **settings}
    )


def fits(sample: TensorDictBase, made: TensorDictBase) -> bool:
    """Whether sampled transitions are those that were made, bit for bit; what follows an episode's end is empty."""
    expected = made.clone()
    for key in STATE:
        expected["next", key][made["next", "terminated"].squeeze(-1)] = 0
    read = [
        "heightmap",
        "action",
        *(("next", key) for key in (*STATE, "reward", "reward_components", "done", "terminated")),
    ]
    return all(torch.equal(sample[key], expected[key]) and sample[key].dtype == expected[key].dtype for key in read)


def test_packing_is_exact_for_what_the_environment_gives() -> None:
    seen = states(3)
    packed = pack(seen["heightmap"], seen["action_mask"])
    assert torch.equal(unpack(packed), seen["heightmap"])
    assert sum(part.nbytes for part in packed.values()) == 3 * (5 * 64 + 8)


@pytest.mark.parametrize("on_disk", [False, True])
@pytest.mark.parametrize("capacity", [1, 2, 7, 100])
def test_every_sample_is_the_transition_that_was_made(capacity: int, on_disk: bool) -> None:
    torch.manual_seed(0)
    buffer = replay(capacity, on_disk=on_disk)
    # Two workers whose episodes come in turn, ends of every kind, batches that end amid an episode, and cells that fill
    # no whole byte.
    ends = [(4, True), (5, False), (1, False), (3, True), (6, False), (1, True), (4, False)]
    made = [episode(steps, 7, 5, terminated) for steps, terminated in ends]
    interleaved = torch.stack((made[0], made[-1]), 1).reshape(-1)
    batches = torch.cat((*made, interleaved, made[1])).split([1, 2, 3, 9, 1, 4, 4, 8, 5])
    stored: dict[int, TensorDictBase] = {}
    for batch in batches:
        first = buffer.cursor
        buffer.extend(batch)
        for i in range(len(batch)):
            stored[(first + i) % capacity] = batch[i]
        for _ in range(5):
            sample = buffer.sample()
            assert fits(sample, torch.stack([stored[place] for place in sample["index"].tolist()]))
    assert len(buffer) == min(capacity, 37)


def test_a_state_is_stored_once_and_a_grasping_sized_transition_is_small() -> None:
    buffer = replay(60, next_states=True)
    for _ in range(2):
        buffer.extend(episode(30, 320, 160, terminated=False))
    assert len(list(buffer.aside)) == 2
    assert buffer.nbytes / len(buffer) <= 300_000
    alone = replay(2, next_states=False)
    alone.extend(episode(1, 320, 160))
    assert alone.nbytes <= 257_000


@pytest.mark.parametrize(("rows", "columns", "count"), [(8, 8, 8), (8, 4, 4)])
def test_augmentation_moves_map_action_and_mask_together(rows: int, columns: int, count: int) -> None:
    buffer = replay(50, 200, augment=True)
    made = episode(50, rows, columns, terminated=False)
    # The chosen cell is marked in the map, and the mask allows exactly the marked cell of the next one.
    marked = torch.zeros(51, rows * columns)
    marked[torch.arange(51), torch.randint(rows * columns, (51,))] = 1
    made["action"] = marked[:-1].argmax(-1)
    made["heightmap"][:, 3], made["next", "heightmap"][:, 3] = (
        part.view(-1, rows, columns) for part in (marked[:-1], marked[1:])
    )
    made["action_mask"], made["next", "action_mask"] = marked[:-1].bool(), marked[1:].bool()
    buffer.extend(made)
    before = buffer.contents()
    after = buffer.sample()
    assert torch.equal(after["heightmap"][:, 3].flatten(1).argmax(-1), after["action"])
    assert torch.equal(after["next", "action_mask"], after["next", "heightmap"][:, 3].flatten(1).bool())
    was = made["heightmap"][after["index"]]
    turns = [[bool(torch.equal(transform(was[i], e), after["heightmap"][i])) for e in range(count)] for i in range(200)]
    assert all(map(any, turns))
    assert all(any(turn[e] for turn in turns) for e in range(count))
    assert all(torch.equal(value, buffer.contents()[name]) for name, value in before.items())


def test_augmentation_of_nothing_to_turn_keeps_a_corner_in_a_corner() -> None:
    maps = torch.zeros(64, 6, 4)
    maps[:, 0, 0] = 1
    batch, state = TensorDict({"action": torch.zeros(64, dtype=torch.int64)}, [64]), TensorDict({"height": maps}, [64])
    augment(batch, [state], torch.Generator().manual_seed(0))
    assert set(batch["action"].tolist()) == {0, 3, 20, 23}
    assert torch.equal(state["height"].flatten(1).argmax(-1), batch["action"])


def test_on_disk_is_as_in_memory_and_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    made, buffers = episode(6, terminated=False), [replay(augment=True, on_disk=on_disk) for on_disk in (False, True)]
    for buffer in buffers:
        buffer.extend(made)
    memory, disk = (buffer.sample() for buffer in buffers)
    assert all(
        torch.equal(memory[key], disk[key])
        for key in ("heightmap", "action", ("next", "heightmap"), ("next", "action_mask"))
    )
    mapped = Path(f"/proc/{os.getpid()}/maps").read_text()
    assert {path.name for path in tmp_path.rglob("*.memmap") if str(path) in mapped} >= {
        "color.memmap",
        "height.memmap",
        "action.memmap",
    }
    again = replay(augment=True, on_disk=True)
    again.restore(buffers[1].contents(), buffers[1].cursor)
    assert all(torch.equal(value, again.contents()[name]) for name, value in buffers[0].contents().items())


@pytest.mark.parametrize("prioritized", [False, True])
def test_sampling_repeats_by_seed_and_survives_a_restore(prioritized: bool) -> None:
    def sampler() -> PrioritySampler | None:
        return PrioritySampler(4, 0.6, 0.4, 1.0) if prioritized else None

    made = episode(9, terminated=False)
    first, second = (replay(4, 3, augment=True, seed=seed, sampler=sampler()) for seed in (1, 2))
    first.extend(made[:3])
    first.learned(first.sample().set("td_error", torch.rand(3)))
    first.extend(made[3:6])
    second.restore(first.contents(), first.cursor)
    second.generator.set_state(first.generator.get_state())
    for extra in (made[6:7], made[7:]):
        a, b = first.sample(0.5), second.sample(0.5)
        assert a.keys() == b.keys()
        assert all(torch.equal(a[key], b[key]) for key in a.keys(True, True))
        for buffer, batch in ((first, a), (second, b)):
            buffer.learned(batch.set("td_error", torch.arange(3.0)))
            buffer.extend(extra)
    assert first.cursor == second.cursor
    assert all(torch.equal(value, second.contents()[name]) for name, value in first.contents().items())
