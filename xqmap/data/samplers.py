"""Which transitions are drawn: more often those whose values are still wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage

from xqmap import keys

# Added to every error, so that no transition is never drawn again.
_LEAST_ERROR = 1e-6
_FILE = "priorities.safetensors"


class PrioritySampler(Sampler):
    """Proportional prioritised replay (Schaul et al. 2016, arXiv:1511.05952): transition i comes with P(i) ∝ p_i =
    (|δ_i| + ε)^α.

    What is drawn more often counts less: w_i = P(i)^−β over the largest of its batch, written as ``priority_weight``. A
        new transition gets
    the highest priority there is. On ``torch.multinomial``: torchrl's own sampler needs a C++ extension that not every
    torch can load.

    Args:
        capacity: of the storage it samples from.
        alpha: how much the error counts; 0 draws all alike.
        beta_init: how much of the bias is taken back at the start of training, 0 to 1.
        beta_end: and at its end.

    Attributes:
        priorities: ``[capacity]`` float64, p_i by place in the storage; 0 where nothing is stored.
        progress: how much of the training is done, 0 to 1.
    """

    def __init__(self, capacity: int, alpha: float, beta_init: float, beta_end: float) -> None:
        self.alpha, self.beta_init, self.beta_end = alpha, beta_init, beta_end
        self.priorities = torch.zeros(capacity, dtype=torch.float64)
        self.progress = 0.0

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Tensor]]:
        """The places ``[B]`` of the transitions drawn, with replacement, and their weights ``[B]``."""
        index = self.priorities[: len(storage)].multinomial(batch_size, replacement=True, generator=self._rng)
        drawn = self.priorities[index]
        beta = self.beta_init + (self.beta_end - self.beta_init) * self.progress
        return index, {keys.PRIORITY_WEIGHT: (drawn / drawn.min()).pow(-beta).float()}

    def extend(self, index: Tensor) -> None:
        """New transitions were stored at the places ``index``."""
        self.priorities[index] = float(self.priorities.max()) or 1.0

    def add(self, index: int) -> None:
        """As :meth:`extend`, for one."""
        self.extend(torch.tensor([index]))

    def update_priority(self, index: Any, priority: Any, *, storage: Storage | None = None) -> None:
        """Takes the errors |δ| ``[B]`` of the transitions at ``index`` ``[B]``; of several for one transition the
        largest counts.
        """
        raised = (torch.as_tensor(priority).double() + _LEAST_ERROR).pow(self.alpha)
        self.priorities.scatter_reduce_(0, torch.as_tensor(index), raised, "amax", include_self=False)

    def state_dict(self) -> dict[str, Any]:
        """The priorities."""
        return {"priorities": self.priorities.clone()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """The inverse of :meth:`state_dict`."""
        self.priorities.copy_(state_dict["priorities"])

    def dumps(self, path: str | Path) -> None:
        """Writes the priorities into the folder ``path``."""
        Path(path).mkdir(parents=True, exist_ok=True)
        save_file(self.state_dict(), Path(path) / _FILE)

    def loads(self, path: str | Path) -> None:
        """The inverse of :meth:`dumps`."""
        self.load_state_dict(load_file(Path(path) / _FILE))

    def _empty(self) -> None:
        self.priorities.zero_()
