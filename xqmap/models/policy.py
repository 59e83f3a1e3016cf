"""From Q-Maps to one action: a single argmax of their sum, and exploration around it."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from xqmap import keys
from xqmap.models.qmaps import write_chosen


def masked_argmax(action_value: Tensor, mask: Tensor | None) -> Tensor:
    """``[*, A]`` → ``[*]`` int64: the action of the highest value among those the mask ``[*, A]`` allows (all, if it
    allows none).
    """
    if mask is not None:
        mask = mask.bool()
        blocked = ~mask & mask.any(-1, keepdim=True)
        action_value = action_value.masked_fill(blocked, -torch.inf)
    return action_value.argmax(-1)


class GreedyPolicy(TensorDictModuleBase):
    """a* = argmax_a Σ_k w_k Q_k(s, a): one argmax for all components.

    Reads what the network reads and, where it is there, ``action_mask``. Writes ``action`` and everything
    :class:`QMaps` writes, the values at the chosen action included (torchrl's value estimators look for them among the
    policy's output).
    """

    def __init__(self, qmaps: TensorDictModuleBase) -> None:
        super().__init__()
        self.qmaps = qmaps
        self.in_keys = [*qmaps.in_keys]
        self.out_keys = [
            keys.ACTION,
            keys.COMPONENT_ACTION_VALUE,
            keys.ACTION_VALUE,
            keys.CHOSEN_ACTION_VALUE,
            keys.CHOSEN_COMPONENT_VALUE,
        ]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Draws the maps, takes the argmax, writes the values at it."""
        tensordict = self.qmaps(tensordict.exclude(keys.ACTION, inplace=True))
        tensordict.set(
            keys.ACTION, masked_argmax(tensordict[keys.ACTION_VALUE], tensordict.get(keys.ACTION_MASK, None))
        )
        return write_chosen(tensordict)


class EpsilonGreedy(TensorDictModuleBase):
    """ε-greedy exploration with a linear schedule; part of the random actions go to raised cells only.

    Args:
        eps_init: ε at the first decision.
        eps_end: ε from ``annealing_frames`` on.
        annealing_frames: decisions over which ε falls.
        raised_share: share of the random actions drawn from cells higher than ``raised_height`` (where objects are),
            the rest from all.
        raised_height: metres above the workspace's floor.
        seed: of the generator the random actions come from.
    """

    def __init__(
        self,
        eps_init: float,
        eps_end: float,
        annealing_frames: int,
        raised_share: float,
        raised_height: float,
        seed: int,
    ) -> None:
        super().__init__()
        self.in_keys = [keys.HEIGHTMAP, keys.ACTION, keys.COMPONENT_ACTION_VALUE, keys.ACTION_VALUE]
        self.out_keys = [keys.ACTION, keys.CHOSEN_ACTION_VALUE, keys.CHOSEN_COMPONENT_VALUE]
        self.eps_init, self.eps_end, self.annealing_frames = eps_init, eps_end, annealing_frames
        self.raised_share, self.raised_height = raised_share, raised_height
        self.generator = torch.Generator().manual_seed(seed)
        self.register_buffer("frames", torch.zeros((), dtype=torch.int64))

    @property
    def eps(self) -> float:
        """The present ε."""
        done = min(1.0, int(self.frames) / max(1, self.annealing_frames))
        return self.eps_init + (self.eps_end - self.eps_init) * done

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Replaces ``action`` ``[*]`` (and the values there) by a random one with probability ε, and counts the
        decisions.
        """
        action = tensordict[keys.ACTION]
        flat = action.reshape(-1)
        allowed = self._allowed(tensordict)
        for i in range(len(flat)):
            if float(torch.rand((), generator=self.generator)) < self.eps:
                flat[i] = random_action(
                    tensordict[keys.HEIGHTMAP].reshape(len(flat), 4, -1)[i, 3],
                    allowed[i],
                    self.raised_height if float(torch.rand((), generator=self.generator)) < self.raised_share else None,
                    self.generator,
                )
        self.frames += len(flat)
        return write_chosen(tensordict.set(keys.ACTION, flat.reshape(action.shape)))

    def _allowed(self, tensordict: TensorDictBase) -> Tensor:
        mask = tensordict.get(keys.ACTION_MASK, None)
        cells = tensordict[keys.HEIGHTMAP].shape[-2:].numel()
        count = tensordict[keys.ACTION].numel()
        return torch.ones(count, cells, dtype=torch.bool) if mask is None else mask.reshape(count, cells)


def random_action(height: Tensor, allowed: Tensor, raised_height: float | None, generator: torch.Generator) -> Tensor:
    """A uniformly drawn allowed cell, ``[]`` int64; with ``raised_height`` (m) one that is higher, where there is any.

    Args:
        height: ``[A]``, m.
        allowed: ``[A]`` bool.
        raised_height: metres above the floor, or None for all allowed cells.
        generator: source of the draw.
    """
    cells = allowed if bool(allowed.any()) else torch.ones_like(allowed)
    if raised_height is not None and bool((raised := cells & (height > raised_height)).any()):
        cells = raised
    return cells.float().multinomial(1, generator=generator)[0]
