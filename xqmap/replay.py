"""The replay buffer: compact storage, and every transition seen from all sides."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyMemmapStorage, LazyTensorStorage, TensorDictReplayBuffer

from xqmap import keys
from xqmap.models.symmetry import elements, transform


class Replay:
    """Transitions with heightmaps as 8-bit colours and half-precision heights.

    Args:
        capacity: transitions kept.
        batch_size: transitions per sample.
        augment: turn and mirror what is sampled (all of D4 where the map is square, flips and the half turn otherwise).
        next_states: keep the next heightmap too; without bootstrapping (γ = 0) nothing reads it.
        seed: of sampling and augmentation.
        on_disk: keep them in memory-mapped files of the system's temporary directory (``TMPDIR``) instead of in memory.
    """

    def __init__(self, capacity: int, batch_size: int, augment: bool, next_states: bool, seed: int, on_disk: bool = False) -> None:
        self.generator = torch.Generator().manual_seed(seed)
        storage = LazyMemmapStorage(capacity) if on_disk else LazyTensorStorage(capacity)
        self.buffer = TensorDictReplayBuffer(storage=storage, batch_size=batch_size, generator=self.generator)
        self.augment = augment
        self.next_states = next_states

    def __len__(self) -> int:
        return len(self.buffer)

    def extend(self, transitions: TensorDictBase) -> None:
        """Stores ``[N]`` transitions; keys that learning does not read are left out."""
        following = [keys.REWARD, keys.REWARD_COMPONENTS, keys.DONE, keys.TERMINATED]
        kept = TensorDict(
            {
                keys.HEIGHTMAP: pack(transitions[keys.HEIGHTMAP]),
                keys.ACTION: transitions[keys.ACTION],
                "next": transitions["next"].select(*following),
            },
            batch_size=transitions.batch_size,
        )
        if self.next_states:
            kept["next", keys.HEIGHTMAP] = pack(transitions["next", keys.HEIGHTMAP])
            kept["next", keys.ACTION_MASK] = transitions["next", keys.ACTION_MASK]
        self.buffer.extend(kept)

    @property
    def cursor(self) -> int:
        """Where the next transition will be written."""
        return int(self.buffer.writer._cursor)

    def contents(self) -> dict[str, Tensor]:
        """What is stored, in storage order, by name (``next.reward``)."""
        return {name: value.contiguous() for name, value in self.buffer[:].flatten_keys(".").items()} if len(self) else {}

    def first(self) -> Tensor:
        """The heightmap ``[4, H, W]`` in the first place of the storage."""
        return unpack(self.buffer[0:1][keys.HEIGHTMAP])[0]

    def restore(self, contents: dict[str, Tensor], cursor: int) -> None:
        """The inverse of :meth:`contents` and :attr:`cursor`, into an empty buffer."""
        if contents:
            count = len(next(iter(contents.values())))
            stored = TensorDict({}, batch_size=[count])
            for name, value in contents.items():
                stored[tuple(name.split("."))] = value
            for part in [(keys.HEIGHTMAP,), ("next", keys.HEIGHTMAP)] if self.next_states else [(keys.HEIGHTMAP,)]:
                stored[part].batch_size = [count]
            self.buffer.extend(stored)
            self.buffer.writer._cursor = cursor

    def sample(self) -> TensorDictBase:
        """``[B]`` transitions with heightmaps ``[B, 4, H, W]`` float32, turned and mirrored at random where augmentation is on."""
        batch = self.buffer.sample()
        batch[keys.HEIGHTMAP] = unpack(batch[keys.HEIGHTMAP])
        if self.next_states:
            batch["next", keys.HEIGHTMAP] = unpack(batch["next", keys.HEIGHTMAP])
        return augment(batch, self.generator) if self.augment else batch


def pack(heightmap: Tensor) -> TensorDict:
    """``[N, 4, H, W]`` → colour uint8 ``[N, 3, H, W]`` and height half ``[N, H, W]``: 5 bytes a cell."""
    parts = {"color": heightmap[:, :3].round().to(torch.uint8), "height": heightmap[:, 3].half()}
    return TensorDict(parts, batch_size=heightmap.shape[:1])


def unpack(packed: TensorDictBase) -> Tensor:
    """The inverse of :func:`pack`, ``[N, 4, H, W]`` float32."""
    return torch.cat((packed["color"].float(), packed["height"].float()[:, None]), dim=1)


def augment(batch: TensorDictBase, generator: torch.Generator) -> TensorDictBase:
    """Turns and mirrors each transition's map and action together, by an element of D4 drawn per transition.

    Args:
        batch: ``[B]`` transitions; ``heightmap``, ``action`` and, where there, the next state's ``heightmap`` and ``action_mask`` change.
        generator: source of the draw.
    """
    rows, columns = batch[keys.HEIGHTMAP].shape[-2:]
    count = elements(rows, columns)
    drawn = torch.randint(count, (len(batch),), generator=generator)
    cells = torch.arange(rows * columns).view(1, rows, columns)
    for element in range(1, count):
        chosen = (drawn == element).nonzero().squeeze(-1)
        if not len(chosen):
            continue
        # Where each cell of the old map lies in the new one.
        moved = transform(cells, element).reshape(-1).argsort()
        batch[keys.ACTION][chosen] = moved[batch[keys.ACTION][chosen]]
        for key in (keys.HEIGHTMAP, ("next", keys.HEIGHTMAP), ("next", keys.ACTION_MASK)):
            maps = batch.get(key, None)
            if maps is not None:
                turned = transform(maps[chosen].reshape(len(chosen), -1, rows, columns), element)
                maps[chosen] = turned.reshape(len(chosen), *maps.shape[1:])
    return batch
