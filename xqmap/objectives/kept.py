"""What is known of the states after stored transitions, so that it need not be computed again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import torch
from torch import Tensor

from xqmap.data.symmetry import moved, origins


class Kept:
    """Q̄_k of stored next states until the target nets move, and, if asked for, the next action a⁺ for some updates.

    A value kept is the value that would be computed. A choice kept is not: a⁺ is then the online nets' of up to
    ``choice_period - 1`` updates ago, and of the side from which they saw the state; the target nets value it as it is
    seen now. With a period of 1 a⁺ is always chosen anew, as in double DQN.

    Args:
        choice_period: updates that one choice serves.
    """

    def __init__(self, choice_period: int = 1) -> None:
        self.choice_period = choice_period
        self.updates = 0
        # By place in the storage: the cell, as it lies from side 0, and the update that chose it.
        self._choices: dict[int, tuple[int, int]] = {}
        # By place, and by side and cell (-1 for what the target nets choose themselves): [K, …].
        self._values: dict[int, dict[tuple[int, int], Tensor]] = {}

    def choices(self, places: Tensor, sides: Tensor, edges: Sequence[int]) -> Tensor:
        """``[N]`` int64: a⁺ of the states after the transitions at ``places``, -1 where it has to be chosen.

        Args:
            places: ``[N]``, in the storage.
            sides: ``[N]``, the element of D4 that each map is turned by.
            edges: H and W of the maps before.
        """
        found = []
        for place, side in zip(places.tolist(), sides.tolist(), strict=True):
            cell, at = self._choices.get(place, (-1, 0))
            known = cell >= 0 and self.updates - at < self.choice_period
            found.append(int(moved(*edges)[side, cell]) if known else -1)
        return torch.tensor(found, device=places.device)

    def choose(self, places: Tensor, sides: Tensor, edges: Sequence[int], cells: Tensor) -> None:
        """Keeps the ``cells`` ``[N]`` chosen now."""
        if self.choice_period > 1:
            for place, side, cell in _rows(places, sides, cells):
                self._choices[place] = int(origins(*edges)[side, cell]), self.updates

    def unknown(self, places: Tensor, sides: Tensor, cells: Tensor) -> Tensor:
        """``[M]``: for which of ``[N]`` states the target nets' values have to be computed; once where one occurs
        twice.

        Args:
            places: ``[N]``, in the storage.
            sides: ``[N]``, the element of D4 that each map is turned by.
            cells: ``[N]``, what is valued; -1 for what the target nets choose themselves.
        """
        rows: dict[tuple[int, int, int], int] = {}
        for row, (place, side, cell) in enumerate(_rows(places, sides, cells)):
            if (side, cell) not in self._values.get(place, {}):
                rows.setdefault((place, side, cell), row)
        return torch.tensor(list(rows.values()), dtype=torch.int64, device=places.device)

    def value(self, places: Tensor, sides: Tensor, cells: Tensor, values: Tensor) -> None:
        """Keeps the ``values`` ``[N, K, …]`` computed now."""
        for (place, side, cell), value in zip(_rows(places, sides, cells), values.cpu().unbind(), strict=True):
            self._values.setdefault(place, {})[side, cell] = value

    def values(self, places: Tensor, sides: Tensor, cells: Tensor) -> Tensor:
        """``[N, K, …]``: the values of what is known."""
        found = [self._values[place][side, cell] for place, side, cell in _rows(places, sides, cells)]
        return torch.stack(found).to(places.device)

    def step(self, moved: bool) -> None:
        """An update has been made; with ``moved`` the target nets are others."""
        self.updates += 1
        if moved:
            self._values.clear()

    def forget(self, places: Iterable[int]) -> None:
        """Other transitions are stored there now."""
        for place in places:
            self._choices.pop(place, None)
            self._values.pop(place, None)

    def state_dict(self) -> dict[str, Tensor]:
        """All of it as tensors, by name."""
        values = [(place, *seen, value) for place, kept in self._values.items() for seen, value in kept.items()]
        found = {"updates": torch.tensor(self.updates)}
        if self._choices:
            found["choices"] = torch.tensor([(place, *chosen) for place, chosen in self._choices.items()])
        if values:
            found["seen"] = torch.tensor([row[:3] for row in values])
            found["values"] = torch.stack([row[3] for row in values])
        return found

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """The inverse of :meth:`state_dict`."""
        self.updates = int(state["updates"])
        if "choices" in state:
            self._choices = {place: (cell, at) for place, cell, at in state["choices"].tolist()}
        if "seen" in state:
            places, sides, cells = state["seen"].unbind(-1)
            self.value(places, sides, cells, state["values"])


def _rows(places: Tensor, sides: Tensor, cells: Tensor) -> Iterator[tuple[int, int, int]]:
    return zip(places.tolist(), sides.tolist(), cells.tolist(), strict=True)
