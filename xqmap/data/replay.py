"""The replay buffer: compact storage, and every transition seen from all sides."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer, TensorStorage
from torchrl.data.replay_buffers.samplers import RandomSampler, Sampler

from xqmap import keys
from xqmap.data.samplers import PrioritySampler
from xqmap.data.symmetry import elements, moved, transform


class Replay:
    """Transitions whose states are stored once, as 8-bit colours, half-precision heights and one bit for each cell that
    may be chosen.

    Within an episode the state after a transition is the next transition's own. Only where the next place holds another
    state (the episode was cut short, another worker's came between, the next is yet to come) is it kept aside, and
    after the end of an episode not at all.

    Args:
        capacity: transitions kept.
        batch_size: transitions per sample.
        augment: turn and mirror what is sampled (all of D4 where the map is square, flips and the half turn otherwise).
        next_states: know the next state too; without bootstrapping (γ = 0) nothing reads it.
        seed: of sampling and augmentation.
        on_disk: keep states in memory-mapped files of the system's temporary directory (``TMPDIR``) instead of in
            memory.
        sampler: which transitions are drawn; all alike when not given.
    """

    def __init__(
        self,
        capacity: int,
        batch_size: int,
        augment: bool,
        next_states: bool,
        seed: int,
        on_disk: bool = False,
        sampler: Sampler | None = None,
    ) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        self.sampler = sampler or RandomSampler()
        self.buffer = TensorDictReplayBuffer(
            storage=_storage(capacity, on_disk), sampler=self.sampler, batch_size=batch_size, generator=self.generator
        )
        self.capacity = capacity
        self.augment = augment
        self.next_states = next_states
        self.aside = Aside(_storage(capacity, on_disk))

    def __len__(self) -> int:
        return len(self.buffer)

    @property
    def nbytes(self) -> int:
        """What is stored."""
        return sum(value.nbytes for value in self.contents().values())

    def extend(self, transitions: TensorDictBase) -> list[int]:
        """Stores ``[N]`` transitions in the order in which they were made; keys that learning does not read are left
        out.

        Returns:
            Their places; what was there before is gone.
        """
        return [place for part in transitions.split(self.capacity) for place in self._extend(part)]

    def _extend(self, transitions: TensorDictBase) -> list[int]:
        following = transitions["next"]
        state = self._pack(transitions)
        outcome = following.select(keys.REWARD, keys.REWARD_COMPONENTS, keys.DONE, keys.TERMINATED)
        kept = {"state": state, keys.ACTION: transitions[keys.ACTION], "next": outcome}
        before = (self.cursor - 1) % self.capacity
        places: list[int] = self.buffer.extend(TensorDict(kept, transitions.batch_size)).tolist()
        if not self.next_states:
            return places
        after, goes_on = self._pack(following), ~following[keys.TERMINATED].squeeze(-1)
        if before in self.aside and _same(self.aside[[before]], state[:1]).all():
            del self.aside[before]
        # The last one's next state is yet to come.
        needed = goes_on & torch.cat((~_same(after[:-1], state[1:]), torch.tensor([True])))
        for place, needs, packed in zip(places, needed.tolist(), after, strict=True):
            if place in self.aside:
                del self.aside[place]
            if needs:
                self.aside[place] = packed
        return places

    def _pack(self, state: TensorDictBase) -> TensorDict:
        return pack(state[keys.HEIGHTMAP], state[keys.ACTION_MASK] if self.next_states else None)

    @property
    def cursor(self) -> int:
        """Where the next transition will be written."""
        return int(self.buffer.writer._cursor)

    def contents(self) -> dict[str, Tensor]:
        """What is stored, in storage order, by name (``next.reward``)."""
        if not len(self):
            return {}
        found = {name: value.contiguous() for name, value in self.buffer[:].flatten_keys(".").items()}
        if isinstance(self.sampler, PrioritySampler):
            found["priority"] = self.sampler.priorities[: len(self)]
        if places := list(self.aside):
            kept = self.aside[places].flatten_keys(".")
            found |= {"aside.place": torch.tensor(places)} | {
                f"aside.state.{name}": value for name, value in kept.items()
            }
        return found

    def first(self) -> Tensor:
        """The heightmap ``[4, H, W]`` in the first place of the storage."""
        return unpack(self.buffer[0:1]["state"])[0]

    def restore(self, contents: dict[str, Tensor], cursor: int) -> None:
        """The inverse of :meth:`contents` and :attr:`cursor`, into an empty buffer."""
        if not contents:
            return
        kept = {name: value for name, value in contents.items() if not name.startswith(("aside.", "priority"))}
        self.buffer.extend(_unflatten(kept))
        self.buffer.writer._cursor = cursor
        if isinstance(self.sampler, PrioritySampler):
            self.sampler.priorities[: len(self)] = contents["priority"]
        if "aside.place" in contents:
            aside = _unflatten(
                {name.removeprefix("aside."): value for name, value in contents.items() if name.startswith("aside.")}
            )
            for place, packed in zip(aside["place"].tolist(), aside["state"], strict=True):
                self.aside[place] = packed

    def sample(self, progress: float = 0.0) -> TensorDictBase:
        """``[B]`` transitions with heightmaps ``[B, 4, H, W]`` float32, turned and mirrored at random where
        augmentation is on.

        Args:
            progress: how much of the training is done, 0 to 1; for a sampler that asks.

        Returns:
            ``heightmap``, ``action``, ``index`` (the places in the storage), ``side`` (the element of D4 that the maps
            are turned by), of prioritised replay ``priority_weight`` ``[B]``, and under ``"next"`` what followed; with
            next states ``heightmap`` and ``action_mask`` ``[B, A]`` too, all 0 after the end of an episode.
        """
        if isinstance(self.sampler, PrioritySampler):
            self.sampler.progress = progress
        batch = self.buffer.sample()
        states = [batch.pop("state").select("color", "height")]
        if self.next_states:
            states.append(self._following(batch["index"], batch["next", keys.TERMINATED]))
        batch[keys.SIDE] = torch.zeros_like(batch["index"])
        if self.augment:
            augment(batch, states, self.generator)
        batch[keys.HEIGHTMAP] = unpack(states[0])
        if self.next_states:
            batch["next", keys.HEIGHTMAP] = unpack(states[1])
            batch["next", keys.ACTION_MASK] = states[1]["allowed"].flatten(1)
        return batch

    def learned(self, batch: TensorDictBase) -> None:
        """Takes the TD errors that the loss wrote into a sample as the priorities of its transitions."""
        if isinstance(self.sampler, PrioritySampler):
            self.buffer.update_priority(batch["index"].cpu(), batch[keys.TD_ERROR].cpu())

    def _following(self, index: Tensor, terminated: Tensor) -> TensorDictBase:
        """The states ``[B]`` after the transitions at the places ``index`` ``[B]``."""
        states = self.buffer[(index + 1) % len(self)]["state"]
        rows = [row for row, place in enumerate(index.tolist()) if place in self.aside]
        if rows:
            states[rows] = self.aside[index[rows].tolist()]
        states.masked_fill_(terminated.squeeze(-1), 0)
        shape = states["height"].shape
        allowed = np.unpackbits(states["allowed"].numpy(), axis=-1, count=shape[1:].numel())
        return states.set("allowed", torch.from_numpy(allowed).view(torch.bool).view(shape))


class Aside:
    """Packed states by the place of the transition that they follow."""

    def __init__(self, storage: TensorStorage) -> None:
        self.storage = storage
        self.rows: dict[int, int] = {}
        self._vacant: list[int] = []

    def __contains__(self, place: int) -> bool:
        return place in self.rows

    def __iter__(self) -> Iterator[int]:
        return iter(self.rows)

    def __getitem__(self, places: Sequence[int]) -> TensorDictBase:
        """``[M]`` states."""
        return self.storage.get(torch.tensor([self.rows[place] for place in places]))

    def __setitem__(self, place: int, state: TensorDictBase) -> None:
        self.rows[place] = self._vacant.pop() if self._vacant else len(self.rows)
        self.storage.set(torch.tensor([self.rows[place]]), state[None])

    def __delitem__(self, place: int) -> None:
        self._vacant.append(self.rows.pop(place))


def pack(heightmap: Tensor, allowed: Tensor | None = None) -> TensorDict:
    """Maps ``[N, 4, H, W]`` and masks ``[N, A]`` as 8-bit colour, half-precision height and one bit a cell: 5⅛ bytes a
    cell.
    """
    parts = {"color": heightmap[:, :3].round().to(torch.uint8), "height": heightmap[:, 3].half()}
    if allowed is not None:
        parts["allowed"] = torch.from_numpy(np.packbits(allowed.numpy(), axis=-1))
    return TensorDict(parts, batch_size=heightmap.shape[:1])


def unpack(packed: TensorDictBase) -> Tensor:
    """The heightmaps ``[N, 4, H, W]`` float32 of what :func:`pack` made."""
    color, height = packed["color"], packed["height"]
    heightmap = torch.empty(len(color), 4, *color.shape[-2:])
    heightmap[:, :3], heightmap[:, 3] = color, height
    return heightmap


def augment(batch: TensorDictBase, states: Sequence[TensorDictBase], generator: torch.Generator) -> None:
    """Turns and mirrors each transition's maps and action together, in place, by an element of D4 drawn per transition.

    Args:
        batch: ``[B]`` transitions: ``action`` changes, and the element drawn becomes their ``side``.
        states: packed states ``[B]``, whose every entry ends in ``[H, W]``.
        generator: source of the draw.
    """
    rows, columns = states[0]["height"].shape[-2:]
    batch[keys.SIDE] = drawn = torch.randint(elements(rows, columns), (len(batch),), generator=generator)
    batch[keys.ACTION] = moved(rows, columns)[drawn, batch[keys.ACTION]]
    # Element 0 leaves all where it is.
    for element in set(drawn.tolist()) - {0}:
        chosen = (drawn == element).nonzero().squeeze(-1)
        for maps in (maps for state in states for maps in state.values()):
            maps[chosen] = transform(maps[chosen], element)


def _same(first: TensorDictBase, second: TensorDictBase) -> Tensor:
    """``[N]`` bool: whether the states of two batches are the same, bit for bit."""
    parts = [
        (first[name].view(torch.uint8) == second[name].view(torch.uint8)).flatten(1).all(1)
        for name in set(first.keys())
    ]
    return torch.stack(parts).all(0)


def _unflatten(named: dict[str, Tensor]) -> TensorDictBase:
    """``{"next.reward": [N, …]}`` → the ``[N]`` TensorDict."""
    return TensorDict(named, [len(next(iter(named.values())))]).unflatten_keys(".")


def _storage(capacity: int, on_disk: bool) -> TensorStorage:
    if not on_disk:
        return LazyTensorStorage(capacity)
    # Told where: torchrl would take shared memory.
    return LazyMemmapStorage(capacity, scratch_dir=tempfile.mkdtemp(prefix="xqmap-replay-"), auto_cleanup=True)
