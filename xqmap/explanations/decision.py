"""One decision with everything its explanation needs: the one input of every view. No view ever runs a network."""

from __future__ import annotations

import itertools
import json
import math
import string
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from xqmap import keys
from xqmap.errors import UserError
from xqmap.explanations import contrast
from xqmap.explanations.perception import Scene

SELECTED = "Selected"
# A decision file larger than this is not one of ours.
_LARGEST_FILE = 50_000_000


@dataclass
class Candidate:
    """An action that is looked at: the selected one, or the best for one component alone.

    Attributes:
        label: ``"Selected"``, ``"A"``, ``"B"``, …
        object: what lies there, in words.
        values: w_k Q_k(s, a) by component name, in component order.
        pixel: row and column in the heightmap.
        position: x, y, z in world metres.
        object_index: which object of the scene it lies on; None for the background or where unknown.
    """

    label: str
    object: str
    values: dict[str, float]
    pixel: tuple[int, int] | None = None
    position: tuple[float, float, float] | None = None
    object_index: int | None = None

    @property
    def overall(self) -> float:
        """Q(s, a) = Σ_k w_k Q_k(s, a)."""
        return sum(self.values.values())


@dataclass
class ObjectValue:
    """An object of the scene and the values at its best cell (the pool over the object's cells)."""

    object: str
    object_index: int
    pixel: tuple[int, int]
    values: dict[str, float]

    @property
    def overall(self) -> float:
        """Σ_k w_k Q_k at that cell."""
        return sum(self.values.values())


@dataclass
class Decision:
    """A policy's choice in one state.

    Attributes:
        task: its name.
        components: names, in order.
        candidates: ``Selected`` first, then one per component.
        scene_seed: of the scene, if it came from one.
        step: which decision of its episode it is, from 0.
        objects: the scene's objects by falling overall value.
        noise: typical error of each component's values (mean |TD error| at the end of training); empty if unknown.
        heightmap: ``[4, H, W]``: 0–255 and metres; None in a decision that was read from a file.
        maps: ``[K, H, W]``: the weighted Q-Maps, NaN where an action cannot be chosen; None likewise.
        bounds: ``[3, 2]``: world extent of the map, m.
    """

    task: str
    components: tuple[str, ...]
    candidates: list[Candidate]
    scene_seed: int | None = None
    step: int = 0
    objects: list[ObjectValue] = field(default_factory=list)
    noise: dict[str, float] = field(default_factory=dict)
    heightmap: np.ndarray | None = None
    maps: np.ndarray | None = None
    bounds: np.ndarray | None = None

    @classmethod
    def from_policy(
        cls,
        policy: Any,
        state: TensorDictBase,
        scene: Scene,
        *,
        task: str,
        components: Sequence[str],
        scene_seed: int | None = None,
        step: int = 0,
        noise: dict[str, float] | None = None,
    ) -> Decision:
        """Builds the decision a policy takes in a state.

        Args:
            policy: writes ``action`` and ``component_action_value`` (``xqmap.models.policy.GreedyPolicy``); its weights scale the values.
            state: ``heightmap`` ``[4, H, W]`` and, where there is one, ``action_mask`` ``[A]``.
            scene: the names of what lies where, from a perception (``xqmap.explanations.perception``).
            task: name of the task.
            components: names of the policy's components, in order.
            scene_seed: of the scene.
            step: which decision of the episode.
            noise: typical error by component.
        """
        names = tuple(components)
        with torch.no_grad():
            out = policy(state.select(keys.HEIGHTMAP, keys.ACTION_MASK, strict=False).clone())
        heightmap = state[keys.HEIGHTMAP].cpu().numpy()
        shape = heightmap.shape[-2:]
        maps = (out[keys.COMPONENT_ACTION_VALUE] * policy.qmaps.weights[:, None]).cpu().double().numpy()
        mask = state.get(keys.ACTION_MASK, None)
        allowed = np.ones(maps.shape[-1], dtype=bool) if mask is None or not bool(mask.any()) else mask.cpu().numpy()
        if not np.isfinite(maps).all():
            raise UserError("the Q-Maps hold NaN or infinite values: the training diverged, lower trainer.learning_rate")
        limited = np.where(allowed, maps, np.nan)

        def candidate(label: str, action: int) -> Candidate:
            pixel = (action // shape[1], action % shape[1])
            values = dict(zip(names, maps[:, action].tolist(), strict=True))
            return Candidate(label, scene.name(pixel), values, pixel, scene.position(pixel), scene.index(pixel))

        candidates = [candidate(SELECTED, int(out[keys.ACTION]))]
        candidates += [candidate(label(k), int(np.nanargmax(limited[k]))) for k in range(len(names))]
        decision = cls(task, names, candidates, scene_seed, step, noise=noise or {}, heightmap=heightmap, bounds=np.array(scene.bounds))
        decision.maps = limited.reshape(len(names), *shape)
        decision.objects = decision._pool(scene)
        return decision

    def _pool(self, scene: Scene) -> list[ObjectValue]:
        assert self.maps is not None
        total = self.maps.sum(0)
        pooled = []
        for index, name in enumerate(scene.names):
            cells = np.where(scene.cells == index, total, np.nan)
            if np.isnan(cells).all():
                continue
            row, column = np.unravel_index(int(np.nanargmax(cells)), cells.shape)
            values = dict(zip(self.components, self.maps[:, row, column].tolist(), strict=True))
            pooled.append(ObjectValue(name, index, (int(row), int(column)), values))
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

    def same(self, first: str, second: str) -> bool:
        """Whether two candidates lie on the same object (or, on the background or where objects are unknown, the same pixel)."""
        a, b = self[first], self[second]
        if a.object_index is not None and b.object_index is not None:
            return a.object_index == b.object_index
        return a.pixel is not None and a.pixel == b.pixel

    def within_noise(self, first: str, second: str) -> bool:
        """Whether the gap of two candidates' overall values is smaller than the values' typical error."""
        error = math.hypot(*(self.noise.get(name, 0.0) for name in self.components))
        return abs(sum(self.rdx(first, second).values())) <= error

    def robustness(self) -> tuple[float, str] | None:
        """The smallest joint change of weights that turns the choice to another object, and that object; None without another."""
        own = self.selected.object_index
        others = [(o.object, o.values) for o in self.objects if o.object_index != own]
        if not self.objects:
            others = [(c.object, c.values) for c in self.alternatives if not self.same(SELECTED, c.label)]
        found = [(contrast.flip_distance(contrast.rdx(self.selected.values, values)), name) for name, values in others]
        return min(found) if found else None

    def sentences(self, wording: Any = None) -> dict[str, Any]:
        """The decision in words; see :mod:`xqmap.explanations.sentences`."""
        from xqmap.explanations import sentences

        return sentences.write(self, wording)

    def to_dict(self, wording: Any = None) -> dict[str, Any]:
        """The content of ``decision.json``."""
        candidates = []
        for c in self.candidates:
            entry: dict[str, Any] = {"label": c.label, "object": c.object}
            entry |= {"pixel": list(c.pixel)} if c.pixel is not None else {}
            entry |= {"position": list(c.position)} if c.position is not None else {}
            candidates.append(entry | {"values": c.values, "overall": c.overall, "object_index": c.object_index})
        msx = []
        for first, second in self.pairs:
            delta = self.rdx(first, second)
            pair = (first, second) if sum(delta.values()) >= 0 else (second, first)
            plus, minus = contrast.msx(self.rdx(*pair))
            msx.append({"pair": list(pair), "plus": plus, "minus": minus})
        return {
            "task": self.task,
            "scene_seed": self.scene_seed,
            "step": self.step,
            "components": list(self.components),
            "candidates": candidates,
            "objects": [
                {"object": o.object, "object_index": o.object_index, "pixel": list(o.pixel), "values": o.values, "overall": o.overall}
                for o in self.objects
            ],
            "rdx": [{"pair": [a, b], "values": self.rdx(a, b)} for a, b in self.pairs],
            "msx": msx,
            "noise": self.noise,
            "sentences": self.sentences(wording),
        }

    def save(self, path: str | Path, wording: Any = None) -> None:
        """Writes ``decision.json``."""
        Path(path).write_text(json.dumps(self.to_dict(wording), indent=1, allow_nan=False) + "\n", encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Decision:
        """Reads a decision file; what can be derived is derived, whatever the file says of it.

        Raises:
            UserError: naming the file and the place that is wrong.
        """
        path = Path(path)
        try:
            if path.stat().st_size > _LARGEST_FILE:
                raise UserError(f"{path}: larger than {_LARGEST_FILE // 1_000_000} MB, which no decision is")
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise UserError(f"{path}: there is no such file; give decision=FILE.json") from None
        except (UnicodeDecodeError, ValueError, RecursionError) as error:
            raise UserError(f"{path}: not JSON ({str(error)[:80]})") from None
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        from xqmap.explanations.reading import parse

        return parse(content, str(path))


def label(k: int) -> str:
    """The label of the k-th component's candidate: A, B, …, Z, AA, …"""
    letters = string.ascii_uppercase
    return letters[k] if k < len(letters) else label(k // len(letters) - 1) + letters[k % len(letters)]
