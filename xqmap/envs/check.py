"""Holds a world against the contract of :mod:`xqmap.envs.protocol`: each line says it is kept, or what to mend."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

from xqmap import keys
from xqmap.envs.heightmap import PixelGrid
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Solvable, Task
from xqmap.errors import brief
from xqmap.models.policy import random_action

# How far two sums of single-precision numbers may lie apart.
_CLOSE = 1e-4
# Decisions after which an episode of the oracle's should be over, and as many random ones as tell of the rules.
_LONGEST, _RANDOM = 200, 12


@dataclass
class Finding:
    """One rule, and where it was broken.

    Attributes:
        rule: what a world has to keep.
        troubles: what to mend, the first ones met; none where the rule is kept.
        seen: how often the rule was put to the test.
    """

    rule: str
    troubles: list[str] = field(default_factory=list)
    seen: int = 0

    def holds(self, kept: bool, trouble: str) -> bool:
        """Notes one test of the rule."""
        self.seen += 1
        if not kept and len(self.troubles) < 3:
            self.troubles.append(trouble)
        return kept

    def __str__(self) -> str:
        if not self.seen:
            return f"not seen  {self.rule}"
        return f"ok        {self.rule}" if not self.troubles else f"MEND      {self.rule}: {'; '.join(self.troubles)}"


def check_task(
    make_task: Callable[..., Task],
    components: Sequence[str],
    weights: Mapping[str, float] | None = None,
    scenes: Sequence[int] = (0, 1),
) -> list[Finding]:
    """Plays a world by random choices and by its own oracle, and holds what it returns against the contract.

    Args:
        make_task: builds the world; takes ``weights={component: w_k}``.
        components: the names that ``task.components`` has, in order.
        weights: w_k; other ones for each component when not given, so that an order that is mixed up shows.
        scenes: their seeds.

    Returns:
        One finding per rule; the world keeps the contract if no finding has ``troubles``.
    """
    given = weights or {name: 1.0 + 0.5 * k for k, name in enumerate(components)}
    checks = {name: Finding(rule) for name, rule in _RULES.items()}
    with _told(checks["builds"]):
        task = make_task(weights=dict(given))
        try:
            checks["builds"].holds(True, "")
            if _offers(task, checks, components):
                _plays(task, checks, [given.get(name, 1.0) for name in components], scenes)
        finally:
            task.close()
        _repeats(make_task, given, checks["repeats"], scenes[0])
    return list(checks.values())


_RULES = {
    "builds": "it can be built, reset, stepped and closed",
    "offers": "it has every attribute and method of xqmap.envs.protocol.Task",
    "names": "REWARD_COMPONENTS are task.components, in order, none twice",
    "bounds": "workspace_bounds are [3, 2], low below high, and pixel_size is above 0",
    "heightmap": "every heightmap is [4, H, W] of that grid and shows something",
    "mask": "reachable leaves cells to choose",
    "parts": "info['reward_components'] are K numbers from 0 to 1",
    "sum": "reward is the sum of w_k r_k in every step",
    "available": "reward_available is no less than what was earned",
    "oracle": "choosing oracle_point earns reward_available",
    "metrics": "info has each of METRICS as one finite number",
    "objects": "scene_objects have name, footprint [P, 2], top and plain attributes",
    "values": "exact_values are [objects, K], finite",
    "ends": "an episode of its oracle ends",
    "repeats": "the same seed gives the same scene, bit for bit, in a world built anew; another seed another one",
}


@contextmanager
def _told(finding: Finding) -> Iterator[None]:
    """An exception of the world is a finding, too."""
    try:
        yield
    except KeyError as error:
        finding.holds(False, f"{error} is missing in what the world returns")
    except Exception as error:
        finding.holds(False, f"{type(error).__name__}: {brief(error)}")


def _offers(task: Any, checks: dict[str, Finding], components: Sequence[str]) -> bool:
    """What can be seen without playing; False if the rest cannot be tried."""
    missing = [name for name in _members() if not hasattr(task, name)]
    if not checks["offers"].holds(not missing, f"missing are {', '.join(missing)}"):
        return False
    names = list(task.REWARD_COMPONENTS)
    checks["names"].holds(names == list(components), f"{names} are not {list(components)}")
    checks["names"].holds(len(set(names)) == len(names) > 0, f"{names}")
    return names == list(components) and _bounds(task, checks["bounds"])


def _members() -> list[str]:
    annotated = Task.__annotations__
    return sorted({*annotated, *(name for name in vars(Task) if not name.startswith("_"))})


def _bounds(task: Task, finding: Finding) -> bool:
    bounds = np.asarray(task.workspace_bounds, dtype=float)
    good = bounds.shape == (3, 2) and bool(np.isfinite(bounds).all()) and bool((bounds[:, 0] < bounds[:, 1]).all())
    finding.holds(good, f"workspace_bounds is {bounds.tolist()}")
    size = task.pixel_size
    return finding.holds(math.isfinite(size) and size > 0, f"pixel_size is {size}") and good


def _plays(task: Task, checks: dict[str, Finding], weights: list[float], scenes: Sequence[int]) -> None:
    env = ManiSkillEnv(lambda: task)
    generator = torch.Generator().manual_seed(0)
    plays = [(scene, by_oracle) for scene in scenes for by_oracle in (True, False)]
    for scene, by_oracle in tqdm(plays, desc="checking", unit="episode"):
        env.next_scene = scene
        state = env.reset()
        for made in range(_LONGEST if by_oracle else _RANDOM):
            where = f"scene {scene}, decision {made + 1}"
            _state(env, state, checks, where)
            if not bool(state[keys.ACTION_MASK].any()):
                break
            if by_oracle:
                action = torch.tensor(env.action_at(task.oracle_point()))
            else:
                action = random_action(state[keys.HEIGHTMAP][3].flatten(), state[keys.ACTION_MASK], None, generator)
            state[keys.ACTION] = action
            state = env.step(state)
            _reward(state, checks, weights, env.metric_names, where, by_oracle)
            if bool(state["next", keys.DONE]):
                checks["ends"].holds(True, "")
                break
            state = step_mdp(state)
        else:
            checks["ends"].holds(not by_oracle, f"scene {scene} goes on after {_LONGEST} decisions")


def _state(env: ManiSkillEnv, state: TensorDictBase, checks: dict[str, Finding], where: str) -> None:
    shape = tuple(state[keys.HEIGHTMAP].shape)
    grid = PixelGrid(np.asarray(env.task.workspace_bounds).tolist(), env.task.pixel_size).shape
    seen = bool((state[keys.HEIGHTMAP] != 0).any())
    checks["heightmap"].holds(shape == (4, *grid) and seen, f"{where}: {shape} over a grid of {tuple(grid)}")
    checks["mask"].holds(bool(state[keys.ACTION_MASK].any()), f"{where}: no cell is reachable")
    with _told(checks["objects"]):
        things = env.task.scene_objects()
        for thing in things:
            outline = np.asarray(thing.footprint, dtype=float)
            plain = isinstance(thing.name, str) and bool(thing.name) and math.isfinite(thing.top)
            checks["objects"].holds(
                plain and outline.ndim == 2 and outline.shape[1] == 2 and bool(np.isfinite(outline).all()),
                f"{where}: {thing.name!r} has footprint {outline.shape} and top {thing.top}",
            )
            json.dumps(thing.attributes)
    if isinstance(env.task, Solvable):
        with _told(checks["values"]):
            exact = env.task.exact_values(0.9)
            if exact is not None:
                fits = exact.shape == (len(things), len(env.components)) and bool(np.isfinite(exact).all())
                checks["values"].holds(fits, f"{where}: {exact.shape} for {len(things)} objects")


def _reward(
    state: TensorDictBase,
    checks: dict[str, Finding],
    weights: list[float],
    metrics: Sequence[str],
    where: str,
    by_oracle: bool,
) -> None:
    after = state["next"]
    parts = after[keys.REWARD_COMPONENTS].double()
    total, available = float(after[keys.REWARD]), float(after[keys.REWARD_AVAILABLE])
    weighed = float(parts @ torch.tensor(weights, dtype=torch.float64))
    inside = bool(((parts >= -_CLOSE) & (parts <= 1 + _CLOSE)).all())
    checks["parts"].holds(inside, f"{where}: {[round(value, 4) for value in parts.tolist()]}")
    checks["sum"].holds(abs(total - weighed) <= _CLOSE * max(1, abs(weighed)), f"{where}: {total:g}, not {weighed:g}")
    checks["available"].holds(total <= available + _CLOSE, f"{where}: {total:g} was earned, {available:g} available")
    if by_oracle:
        checks["oracle"].holds(abs(total - available) <= _CLOSE, f"{where}: {total:g} of {available:g}")
    for name in metrics:
        checks["metrics"].holds(math.isfinite(float(after[name])), f"{where}: {name} is {float(after[name])}")


def _repeats(make_task: Callable[..., Task], weights: Mapping[str, float], finding: Finding, scene: int) -> None:
    shown = []
    for seed in (scene, scene, scene + 1):
        env = ManiSkillEnv(lambda: make_task(weights=dict(weights)), seed)
        try:
            state = env.reset()
            state[keys.ACTION] = torch.tensor(env.action_at(env.task.oracle_point()))
            after = env.step(state)["next"]
            shown.append((state[keys.HEIGHTMAP], after[keys.REWARD_COMPONENTS], after[keys.HEIGHTMAP]))
        finally:
            env.close()
    first, second, other = shown
    finding.holds(torch.equal(first[0], second[0]), f"scene {scene} looked otherwise the second time")
    same = torch.equal(first[1], second[1]) and torch.equal(first[2], second[2])
    finding.holds(same, f"scene {scene} went otherwise the second time")
    finding.holds(not torch.equal(first[0], other[0]), f"scenes {scene} and {scene + 1} look the same")
