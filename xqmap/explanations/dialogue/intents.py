"""What is asked: the intent whose line explains most of a question (``conf/explain/language/intents.yaml``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from xqmap.explanations.dialogue.language import intents


@dataclass(frozen=True)
class Line:
    """One line of an intent: groups of concepts of which one each has to be there, may be there, must not be there."""

    kind: str
    needs: tuple[tuple[str, ...], ...]
    may: tuple[str, ...]
    never: tuple[str, ...]

    def explains(self, bag: Mapping[str, float], weights: Mapping[str, float]) -> float | None:
        """How many words of a question this line accounts for; None where it does not fit."""
        if any(name in bag for name in self.never):
            return None

        left = {name: words * weights.get(name, 1.0) for name, words in bag.items()}
        total = 0.0
        for group in self.needs:
            best = max((name for name in group if name in left), key=left.__getitem__, default=None)
            if best is None:
                return None
            # No word counts twice.
            total += left.pop(best)
        return total + sum(left.get(name, 0.0) for name in self.may)


@cache
def lines() -> tuple[Line, ...]:
    """All lines, in the order of the file."""
    found = []
    for kind, texts in intents()["intents"].items():
        for text in texts:
            parts = text.split()
            needs = tuple(tuple(part.split("/")) for part in parts if part[0] not in "~-")
            may, never = (tuple(part[1:] for part in parts if part[0] == sign) for sign in "~-")
            found.append(Line(kind, needs, may, never))
    return tuple(found)


def choose(bag: Mapping[str, float]) -> tuple[str, float]:
    """The intent of a question, ``unknown`` where no line fits, and how many words it accounts for."""
    weights = {name: float(weight) for name, weight in intents()["weights"].items()}
    scored = [(score, line.kind) for line in lines() if (score := line.explains(bag, weights)) is not None]
    best = max(scored, key=lambda item: item[0], default=(0.0, "unknown"))
    return best[1], best[0]
