"""One decision with everything its explanation needs: the one input of every view. No view ever runs a network."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from xqmap import keys
from xqmap.errors import UserError
from xqmap.explanations import contrast, files
from xqmap.explanations.candidate import SELECTED, Candidate, label, together
from xqmap.explanations.scene import Scene
from xqmap.explanations.views import sentences

if TYPE_CHECKING:
    from tensordict import TensorDictBase

# Cells around an object that speak for it as much as for the background, whose best cell is looked for farther away.
_EDGE = 2
# What follows and is worth less than this does not show in two decimals.
_FORESEEN = 0.005


@dataclass
class Decision:
    """A policy's choice in one state.

    Attributes:
        task: its name.
        components: names, in order.
        candidates: ``Selected`` first, then one per component.
        scene_seed: of the scene, if it came from one.
        step: which decision of its episode it is, from 0.
        objects: what is in the scene, the background included, each taken at its best cell (of the background, away
            from objects); by falling overall value.
        noise: typical error of each component's values (mean |TD error| at the end of training); empty if unknown.
        heightmap: ``[4, H, W]``: 0–255 and metres; None where only the numbers are known.
        maps: ``[K, H, W]``: the weighted Q-Maps, NaN where an action cannot be chosen; None likewise.
        scene: what lies on each cell; None likewise.
        played: what really came of candidates, by label: of each copy of the world the discounted sub-rewards w_k r_k
            from this decision to the episode's end, by component.
        parts: ``[K, P, H, W]``: what the maps are the sum of, see :class:`~xqmap.explanations.Candidate`; None where
            they cannot be told apart.

    Examples:
        >>> from xqmap.explanations import Candidate, Decision
        >>> decision = Decision(
        ...     "landing",
        ...     ("flatness", "color"),
        ...     [
        ...         Candidate("Selected", "blue flat block", {"flatness": 0.98, "color": 1.01}),
        ...         Candidate("A", "ground", {"flatness": 1.0, "color": 0.01}),
        ...         Candidate("B", "red inclined block", {"flatness": 0.02, "color": 1.03}),
        ...     ],
        ... )
        >>> decision.shallow
        'color'
        >>> {name: round(value, 2) for name, value in decision.rdx("Selected", "B").items()}
        {'flatness': 0.96, 'color': -0.02}
        >>> print(decision.sentences()["contrastive"][1])  # doctest: +NORMALIZE_WHITESPACE
        I chose to land on the blue flat block rather than the red inclined block (B), because flatness speaks for it
        (+0.96), though color speaks against it (-0.02). If flatness counted 0.02 times as much, the red inclined block
        would be just as good.
    """

    task: str
    components: tuple[str, ...]
    candidates: list[Candidate]
    scene_seed: int | None = None
    step: int = 0
    objects: list[Candidate] = field(default_factory=list)
    noise: dict[str, float] = field(default_factory=dict)
    heightmap: np.ndarray | None = None
    maps: np.ndarray | None = None
    scene: Scene | None = None
    parts: np.ndarray | None = None
    played: dict[str, list[dict[str, float]]] = field(default_factory=dict)

    @classmethod
    def from_policy(
        cls,
        policy: Any,
        state: TensorDictBase,
        scene: Scene,
        *,
        task: str,
        components: Sequence[str],
        level: str = "pixel",
        scene_seed: int | None = None,
        step: int = 0,
        noise: dict[str, float] | None = None,
    ) -> Self:
        """Builds the decision a policy takes in a state.

        Args:
            policy: writes ``action`` and ``component_action_value`` (``xqmap.models.policy.GreedyPolicy``); its weights
                scale the values.
            state: ``heightmap`` ``[4, H, W]`` and, where there is one, ``action_mask`` ``[A]``.
            scene: the names of what lies where, from a perception (``xqmap.explanations.perception``).
            task: name of the task.
            components: names of the policy's components, in order.
            level: what A, B, … are the best of for their component: every ``"pixel"``, or every ``"object"`` taken at
                its best cell.
            scene_seed: of the scene.
            step: which decision of the episode.
            noise: typical error by component.

        Raises:
            UserError: if the maps are not finite, or ``level`` is neither.
        """
        if level not in ("pixel", "object"):
            raise UserError(f"candidates={level} is neither pixel nor object")
        # It takes seconds, which a decision from a file need not wait for.
        import torch

        names = tuple(components)
        with torch.no_grad():
            out = policy(state.select(keys.HEIGHTMAP, keys.ACTION_MASK, strict=False).clone())
        heightmap = state[keys.HEIGHTMAP].cpu().numpy()
        weights = policy.qmaps.weights[:, None]
        maps = (out[keys.COMPONENT_ACTION_VALUE] * weights).cpu().double().numpy()
        told = out.get(keys.COMPONENT_PART_VALUE, None)
        mask = state.get(keys.ACTION_MASK, None)
        allowed = np.ones(maps.shape[-1], dtype=bool) if mask is None or not bool(mask.any()) else mask.cpu().numpy()
        if not np.isfinite(maps).all():
            raise UserError(
                "the Q-Maps hold NaN or infinite values: the training diverged, lower trainer.learning_rate"
            )
        shape = len(names), *heightmap.shape[-2:]
        limited = np.where(allowed, maps, np.nan).reshape(shape)
        # Where nothing follows, all is paid now.
        parts = limited[:, None] if getattr(policy.qmaps, "gamma", None) == 0 else None
        if told is not None:
            parts = (told * weights[..., None]).cpu().double().numpy().reshape(len(names), -1, *shape[1:])
        decision = cls(task, names, [], scene_seed, step, [], noise or {}, heightmap, limited, scene, parts)
        decision.objects = decision._pool(scene)
        selected = divmod(int(out[keys.ACTION]), heightmap.shape[-1])
        if level == "pixel":
            best = [divmod(int(np.nanargmax(image)), heightmap.shape[-1]) for image in limited]
        else:
            best = [max(decision.objects, key=lambda thing: thing.values[name]).pixel or selected for name in names]
        decision.candidates = [
            decision.at(selected, SELECTED),
            *(decision.at(pixel, label(k)) for k, pixel in enumerate(best)),
        ]
        return decision

    def at(self, pixel: tuple[int, int], called: str) -> Candidate:
        """The action on a pixel of the maps, under the label ``called``."""
        assert self.maps is not None and self.scene is not None
        row, column = pixel
        values = dict(zip(self.components, self.maps[:, row, column].tolist(), strict=True))
        parts = None
        if self.parts is not None:
            parts = dict(zip(self.components, self.parts[:, :, row, column].tolist(), strict=True))
        return Candidate(
            called, self.scene.name(pixel), values, pixel, self.scene.position(pixel), self.scene.index(pixel), parts
        )

    @property
    def horizon(self) -> int:
        """How many of the next decisions are told apart."""
        parts = [candidate.parts for candidate in self.candidates]
        return min(0 if not told else max(0, min(map(len, told.values())) - 2) for told in parts)

    @property
    def foresees(self) -> bool:
        """Whether something is expected to follow one of the candidates."""
        later = [candidate.later for candidate in self.candidates]
        return any(abs(value) >= _FORESEEN for parts in later if parts for value in parts.values())

    def _pool(self, scene: Scene) -> list[Candidate]:
        from scipy import ndimage  # a third of a second: as torch, see above

        assert self.maps is not None
        total = self.maps.sum(0)
        pooled = []
        edge = ndimage.binary_dilation(scene.cells >= 0, iterations=_EDGE) & (scene.cells < 0)
        for index, name in enumerate([*scene.names, scene.background]):
            inside = np.where(scene.cells == (index if index < len(scene.names) else -1), total, np.nan)
            away = np.where(edge, np.nan, inside)
            cells = inside if np.isnan(away).all() else away
            if not np.isnan(cells).all():
                row, column = np.unravel_index(int(np.nanargmax(cells)), cells.shape)
                pooled.append(self.at((int(row), int(column)), name))
        return sorted(pooled, key=lambda thing: -thing.overall)

    def __getitem__(self, wanted: str) -> Candidate:
        """The candidate with this label."""
        for candidate in self.candidates:
            if candidate.label == wanted:
                return candidate
        raise KeyError(f"no candidate {wanted!r}; there are {', '.join(c.label for c in self.candidates)}")

    @property
    def selected(self) -> Candidate:
        """The action taken."""
        return self[SELECTED]

    @property
    def alternatives(self) -> list[Candidate]:
        """The other candidates."""
        return [candidate for candidate in self.candidates if candidate.label != SELECTED]

    @property
    def shallow(self) -> str:
        """The component with the largest value at the selected action; ties by component order."""
        return max(self.components, key=lambda name: self.selected.values[name])

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """All pairs of labels, in candidate order."""
        return list(itertools.combinations([candidate.label for candidate in self.candidates], 2))

    def rdx(self, first: str, second: str) -> dict[str, float]:
        """Δ_k between two candidates, by component."""
        return contrast.rdx(self[first].values, self[second].values)

    def sooner(self, first: str, second: str) -> dict[str, float] | None:
        """Of Δ_k, what is paid now; None where it cannot be told apart from what follows."""
        ours, theirs = self[first].now, self[second].now
        return None if ours is None or theirs is None else contrast.rdx(ours, theirs)

    def same(self, first: str, second: str) -> bool:
        """Whether two candidates lie on the same object (or, on the background or where objects are unknown, the same
        pixel).
        """
        return together(self[first], self[second])

    @property
    def error(self) -> float:
        """Typical error of an overall value: the components' typical errors, taken as independent. 0 where unknown."""
        return math.hypot(*(self.noise.get(name, 0.0) for name in self.components))

    def within_noise(self, first: str, second: str) -> bool:
        """Whether the gap of two candidates' overall values is no larger than the values' typical error."""
        return abs(sum(self.rdx(first, second).values())) <= self.error

    @property
    def others(self) -> list[Candidate]:
        """What else could have been chosen: the other objects at their best cells, or the other candidates where
        objects are unknown.
        """
        chosen = self.selected
        if self.objects:
            return [o for o in self.objects if (o.object_index, o.object) != (chosen.object_index, chosen.object)]
        apart = [c for c in self.alternatives if not together(chosen, c)]
        return sorted(apart, key=lambda candidate: -candidate.overall)

    def robustness(self) -> tuple[float, str] | None:
        """The smallest joint change of weights that turns the choice to another object, and that object; None without
        another.

        With maps it is the minimum over all actions elsewhere, else over :attr:`others`.
        """
        others = [
            (contrast.flip_distance(contrast.rdx(self.selected.values, other.values)), other.object)
            for other in self.others
        ]
        if not others or self.maps is None or self.scene is None:
            return min(others) if others else None
        own = -1 if self.selected.object_index is None else self.selected.object_index
        delta = np.array(list(self.selected.values.values()))[:, None, None] - self.maps
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = delta.sum(0) / np.linalg.norm(delta, axis=0)
        distance = np.where(np.isnan(distance) & ~np.isnan(self.maps[0]), np.inf, distance)
        distance[self.scene.cells == own] = np.nan
        row, column = np.unravel_index(int(np.nanargmin(distance)), distance.shape)
        return float(distance[row, column]), self.scene.name((int(row), int(column)))

    def best_under(self, factors: Mapping[str, float]) -> Candidate:
        """What would be chosen with other weights: Q_w = Σ_k factor_k w_k Q_k over all actions, or over what is known
        without maps.
        """

        def worth(values: Mapping[str, float]) -> float:
            return sum(factors[name] * values[name] for name in self.components)

        if self.maps is None:
            return max([*self.candidates, *self.objects], key=lambda candidate: worth(candidate.values))
        total = sum(factors[name] * image for name, image in zip(self.components, self.maps, strict=True))
        row, column = np.unravel_index(int(np.nanargmax(total)), self.maps.shape[1:])
        return self.at((int(row), int(column)), "")

    def sentences(self, wording: Any = None) -> dict[str, Any]:
        """The decision in words; see :mod:`xqmap.explanations.views.sentences`."""
        return sentences.write(self, wording)

    def to_dict(self, wording: Any = None) -> dict[str, Any]:
        """The content of ``decision.json``."""
        return files.content(self, wording)

    def save(self, path: str | Path, wording: Any = None) -> list[Path]:
        """Writes ``decision.json`` and, beside it, the maps as ``decision.npz`` where there are any; returns the
        paths.
        """
        return files.save(self, Path(path), wording)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a decision file, and the maps beside it; what can be derived is derived, whatever the file says of it.

        Raises:
            UserError: naming the file and the place that is wrong.
        """
        return cls(**files.load(Path(path)))
