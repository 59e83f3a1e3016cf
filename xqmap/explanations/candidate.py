"""One action that a decision looks at."""

from __future__ import annotations

import string
from dataclasses import dataclass

SELECTED = "Selected"


@dataclass
class Candidate:
    """An action that is looked at: the selected one, the best for one component alone, or the best on an object of the
    scene.

    Attributes:
        label: ``"Selected"``, ``"A"``, ``"B"``, …; an object that is no candidate goes by its name.
        object: what lies there, in words.
        values: w_k Q_k(s, a) by component name, in component order.
        pixel: row and column in the heightmap.
        position: x, y, z in world metres.
        object_index: which object of the scene it lies on; None for the background or where unknown.
        parts: what each of ``values`` is the sum of: what the action itself pays, then what is expected to follow,
            discounted: by each of the next decisions where these are told apart, and by all later ones; only the first
            where nothing follows. None where what is paid cannot be told apart from what follows.
    """

    label: str
    object: str
    values: dict[str, float]
    pixel: tuple[int, int] | None = None
    position: tuple[float, float, float] | None = None
    object_index: int | None = None
    parts: dict[str, list[float]] | None = None

    @property
    def now(self) -> dict[str, float] | None:
        """Of ``values``, what the action itself pays, w_k now_k; None as :attr:`parts`."""
        return None if self.parts is None else {name: parts[0] for name, parts in self.parts.items()}

    @property
    def later(self) -> dict[str, float] | None:
        """Of ``values``, what is expected to follow the action, discounted, γ w_k later_k; None as :attr:`parts`."""
        return None if self.parts is None else {n: value - self.parts[n][0] for n, value in self.values.items()}

    @property
    def overall(self) -> float:
        """Q(s, a) = Σ_k w_k Q_k(s, a)."""
        return sum(self.values.values())


def together(first: Candidate, second: Candidate) -> bool:
    """Whether two actions go to the same object, or to the same pixel where there is none."""
    if first.object_index is not None or second.object_index is not None:
        return first.object_index == second.object_index
    return first.pixel is not None and first.pixel == second.pixel


def label(k: int) -> str:
    """The label of the k-th component's candidate: A, B, …, Z, AA, …"""
    letters = string.ascii_uppercase
    return letters[k] if k < len(letters) else label(k // len(letters) - 1) + letters[k % len(letters)]
