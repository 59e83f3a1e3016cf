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
        now: of ``values``, what the action itself pays, w_k now_k; None where it cannot be told apart from what
            follows.
    """

    label: str
    object: str
    values: dict[str, float]
    pixel: tuple[int, int] | None = None
    position: tuple[float, float, float] | None = None
    object_index: int | None = None
    now: dict[str, float] | None = None

    @property
    def later(self) -> dict[str, float] | None:
        """Of ``values``, what is expected to follow the action, discounted, γ w_k later_k; None as :attr:`now`."""
        return None if self.now is None else {name: value - self.now[name] for name, value in self.values.items()}

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
