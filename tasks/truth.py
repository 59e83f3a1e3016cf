"""What the grasping world knows of itself: for evaluation and perception only, never for the policy."""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien

from . import oracle
from .agents.ur5e import UR5e
from .base import DecisionEnv, SceneObject
from .offers import Offer, in_time, offer
from .primitives import Arm
from .tabletop import TOP, Thing, carried, cube_top, footprint, pose_of
from .workcell import BOUNDS, CELLS

# Scenes by which the best fixed order is found, and the most objects of which every order of removal is solved.
ORDERED, SOLVED = 200, 16


class Known(DecisionEnv):
    """The objects on the table, what a pick can make of them, and what they are worth by the exact solution."""

    # Who is asked besides: the highest reward now, the best order that looks at one object at a time, the best by Q*.
    ADVISERS = ("myopic", "fixed order", "oracle")
    agent: UR5e
    arm: Arm
    object_range: tuple[int, int]
    failure: oracle.Failure
    seal: str
    hover: float
    _home: np.ndarray
    _things: dict[sapien.Entity, Thing]

    def __init__(self, **kwargs: Any) -> None:
        self._solvers: dict[tuple[Any, ...], oracle.Solver] = {}
        self._blind: dict[oracle.Solver, oracle.Choose] = {}
        super().__init__(**kwargs)

    def _on_table(self) -> dict[sapien.Entity, Thing]:
        """The objects within the workspace; what fell off or out of it is out of the game."""
        low, high = BOUNDS.T
        return {
            built: thing
            for built, thing in self._things.items()
            if (low <= built.pose.p).all() and (built.pose.p < high).all()
        }

    def _offers(self) -> list[Offer]:
        """What a pick can make of each object on the table."""
        found = [offer(built, self._things, CELLS, self.reachable, self.seal) for built in self._on_table()]
        return in_time(found, self.arm.limit, self.hover, self._home, self.arm.period)

    def _items(self, offers: list[Offer]) -> list[oracle.Item]:
        things = self._on_table()
        cubes = [i for i, thing in enumerate(things.values()) if thing.kind == "cube"]
        below = carried([pose_of(built) for built, thing in things.items() if thing.kind == "cube"])
        on = {cube: None if at is None else cubes[at] for cube, at in zip(cubes, below, strict=True)}
        items = []
        for i, (thing, found) in enumerate(zip(things.values(), offers, strict=True)):
            # What lies below another is taken when that is gone.
            buried = i in on.values()
            rank = thing.rank * (buried or found.touch is not None)
            items.append(oracle.Item(rank, buried or found.lift is not None, on.get(i)))
        return items

    def _solver(self, gamma: float) -> oracle.Solver:
        rules = gamma, self.failure, tuple(self.weights.tolist())
        if rules not in self._solvers:
            self._solvers[rules] = oracle.Solver(rules[2], gamma, self.failure)
        return self._solvers[rules]

    def highest_reward(self) -> float:
        """Σ_k w_k r_k of the best object on the table; 0 where there is none."""
        now, _ = self._solver(0.0).values(self._items(self._offers()))
        return max((self.weighed(dict(zip(self.REWARD_COMPONENTS, paid, strict=True))) for paid in now), default=0.0)

    def oracle_point(self) -> np.ndarray:
        """``[3]``, m: on the object of the highest reward, as near to its middle as that can be earned."""
        return self._point_of(oracle.optimal(self._solver(0.0)))

    def advice(self, name: str, gamma: float) -> np.ndarray:
        """``[3]``, m: where someone of :attr:`ADVISERS` would pick."""
        solver = self._solver(gamma)
        if name == "fixed order":
            if solver not in self._blind:
                self._blind[solver] = oracle.blind(solver, oracle.sampled(ORDERED, self.object_range))
            return self._point_of(self._blind[solver])
        return self._point_of({"myopic": oracle.myopic, "oracle": oracle.optimal}[name](solver))

    def _point_of(self, choose: oracle.Choose) -> np.ndarray:
        offers = self._offers()
        items = self._items(offers)
        chosen = offers[choose(items)] if items else Offer()
        return np.array([*BOUNDS[:2].mean(1), 0.0]) if chosen.point is None else chosen.point

    def exact_values(self, gamma: float) -> np.ndarray | None:
        """Q*_k ``[objects, 2]`` of each of :meth:`scene_objects`, from the exact solution in :mod:`.oracle`; None where
        it is beyond reckoning: at γ = 1 with bowls that pay for ever, and with too many that are removed one by one.
        """
        items = self._items(self._offers())
        if (gamma == 1 and self.failure == "stays") or (self.failure == "removed" and len(items) > SOLVED):
            return None
        return self._solver(gamma).component_values(items)

    def scene_objects(self) -> list[SceneObject]:
        """The objects on the table."""
        found = []
        for built, thing in self._on_table().items():
            pose = pose_of(built)
            top = float(cube_top(pose)[2]) if thing.kind == "cube" else float(pose[2, 3]) + TOP["bowl"]
            attributes = {"color": thing.color, "kind": thing.kind, "rank": thing.rank}
            found.append(SceneObject(thing.name, footprint(thing.kind, pose[:3, 3], pose[:3, :3]), top, attributes))
        return found
