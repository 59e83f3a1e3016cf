"""Where the things of a decision lie, as a person sees them in the picture, whose origin is at its lower left."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

import numpy as np

from xqmap.explanations.candidate import Candidate, together
from xqmap.explanations.decision import Decision

# Directions of the picture: the axis (0: rows, 1: columns) and which end of it.
DIRECTIONS = {"bottom": (0, 0), "top": (0, 1), "left": (1, 0), "right": (1, 1)}
# How much of the picture's side belongs to a direction, to its edge, and to a corner.
_SIDE, _EDGE, _CORNER = 1 / 3, 0.12, 0.3


class Places:
    """The things of a decision, each once, and their places.

    Args:
        decision: whose things they are.

    Attributes:
        things: the objects and the background; each as the chosen one or a lettered one where these lie on it.
    """

    def __init__(self, decision: Decision) -> None:
        self.decision = decision
        self.things: list[Candidate] = []
        for thing in decision.objects:
            known = [c for c in decision.candidates if together(c, thing) or _alike(c, thing)]
            self.things.append(known[0] if known else thing)
        for candidate in decision.candidates:
            if not any(
                candidate is thing or together(candidate, thing) or _alike(candidate, thing) for thing in self.things
            ):
                self.things.append(candidate)

    @property
    def objects(self) -> list[Candidate]:
        """The things without the background, where objects are known."""
        return [thing for thing in self.things if thing.object_index is not None] or self.things

    @property
    def extent(self) -> tuple[int, int] | None:
        """Rows and columns of the picture; of what is known of it, where there is none."""
        if self.decision.maps is not None:
            return self.decision.maps.shape[1], self.decision.maps.shape[2]
        pixels = [c.pixel for c in (*self.decision.candidates, *self.decision.objects) if c.pixel is not None]
        return (max(row for row, _ in pixels) + 1, max(column for _, column in pixels) + 1) if pixels else None

    def centre(self, thing: Candidate) -> tuple[float, float] | None:
        """Row and column of the middle of what is seen of a thing; of the background, of the cell looked at."""
        scene = self.decision.scene
        if scene is not None and thing.object_index is not None:
            cells = np.argwhere(scene.cells == thing.object_index)
            if len(cells):
                row, column = cells.mean(0)
                return float(row), float(column)
        return (float(thing.pixel[0]), float(thing.pixel[1])) if thing.pixel is not None else None

    def share(self, thing: Candidate) -> tuple[float, float] | None:
        """How far up and how far right a thing lies, from 0 to 1."""
        centre, extent = self.centre(thing), self.extent
        if centre is None or extent is None:
            return None
        return (centre[0] + 0.5) / extent[0], (centre[1] + 0.5) / extent[1]

    def lies(self, thing: Candidate, words: Collection[str]) -> bool:
        """Whether a thing lies where place words say: directions, ``middle``, ``corner``, ``edge``; with
        ``half``, directions reach to the middle.
        """
        share = self.share(thing)
        if share is None:
            return False
        far = [min(at, 1 - at) for at in share]
        for word in words:
            if word in DIRECTIONS:
                axis, end = DIRECTIONS[word]
                limit = _EDGE if "edge" in words else 0.5 if "half" in words else _SIDE
                if abs(share[axis] - end) > limit:
                    return False
            elif (
                (word == "middle" and not all(_SIDE < at < 1 - _SIDE for at in share))
                or (word == "corner" and max(far) > _CORNER)
                or (word == "edge" and min(far) > _EDGE)
            ):
                return False
        return True

    def farthest(self, things: Iterable[Candidate], words: Collection[str]) -> list[Candidate]:
        """Things in order of how far they lie in the directions that are named, the farthest first."""
        ends = [DIRECTIONS[word] for word in words if word in DIRECTIONS]

        def away(thing: Candidate) -> float:
            share = self.share(thing)
            return sum(abs(share[axis] - end) for axis, end in ends) if share else math.inf

        return sorted(things, key=away)

    def place(self, thing: Candidate) -> str:
        """Where a thing lies: ``top left``, ``left``, ``middle``, …, with ``edge`` or ``corner``; empty if unknown."""
        share = self.share(thing)
        if share is None:
            return ""
        words = [word for word, (axis, end) in DIRECTIONS.items() if abs(share[axis] - end) <= _SIDE]
        if not words:
            return "middle"
        # At most one of each axis; up or down is said first.
        words.sort(key=lambda word: DIRECTIONS[word][0])
        near = [word for word in words if abs(share[DIRECTIONS[word][0]] - DIRECTIONS[word][1]) <= _EDGE]
        if len(words) == 1 and near:
            return f"{words[0]} edge"
        return " ".join(words) + (" corner" if len(near) == 2 else "")

    def apart(self, first: Candidate, second: Candidate) -> float:
        """How many cells lie between the middles of two things."""
        one, other = self.centre(first), self.centre(second)
        return math.dist(one, other) if one and other else math.inf

    def beside(self, thing: Candidate, other: Candidate, word: str) -> float:
        """How far a thing lies to the left, right, top or bottom of another, in cells; negative on the other side."""
        one, two = self.centre(thing), self.centre(other)
        axis, end = DIRECTIONS[word]
        return (one[axis] - two[axis]) * (1 if end else -1) if one and two else -math.inf

    def between(self, thing: Candidate, first: Candidate, second: Candidate) -> float:
        """How far a thing lies beside the line between two others, in cells; infinite beyond its ends."""
        centres = [self.centre(c) for c in (thing, first, second)]
        if any(centre is None for centre in centres):
            return math.inf
        at, start, end = (np.array(centre) for centre in centres)
        along = end - start
        part = float((at - start) @ along / max(float(along @ along), 1e-9))
        return float(np.linalg.norm(at - start - part * along)) if 0 < part < 1 else math.inf

    def metres(self, first: Candidate, second: Candidate) -> float | None:
        """The distance of two things' cells over the ground."""
        if first.position is None or second.position is None:
            return None
        return math.dist(first.position[:2], second.position[:2])

    def cells(self, thing: Candidate) -> int | None:
        """How many cells of a thing are seen."""
        if self.decision.scene is None or thing.object_index is None:
            return None
        return int((self.decision.scene.cells == thing.object_index).sum())

    def area(self, thing: Candidate) -> float | None:
        """Square metres that are seen of a thing."""
        cells, scene = self.cells(thing), self.decision.scene
        if cells is None or scene is None:
            return None
        (x0, x1), (y0, y1), _ = scene.bounds
        return cells * (x1 - x0) * (y1 - y0) / scene.cells.size

    def height(self, thing: Candidate) -> float | None:
        """Metres that a thing's cell stands above the background, or above z = 0 where that is unknown."""
        if thing.position is None:
            return None
        scene = self.decision.scene
        floor = 0.0
        if scene is not None and (scene.cells < 0).any():
            floor = float(scene.bounds[2][0]) + float(np.median(scene.height[scene.cells < 0]))
        return thing.position[2] - floor


def _alike(candidate: Candidate, thing: Candidate) -> bool:
    """Whether a candidate and a thing go by the same name on the background, or where objects are not told apart."""
    indices = candidate.object_index, thing.object_index
    return candidate.object == thing.object and indices == (None, None)
