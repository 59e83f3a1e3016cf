"""A world small enough to solve exactly: colored patches on a table seen by one camera from above; each patch can be
taken once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

import numpy as np
import torch

SIZE = 16
CELL = 0.1
EDGE = 4
CAMERA_HEIGHT = 10.0
# color (red, green, blue), (r_left, r_right), row and column of the patch's first cell
PATCHES = (
    ("red", (250, 10, 10), (1.0, 0.0), (2, 2)),
    ("green", (10, 250, 10), (0.2, 0.6), (2, 10)),
    ("blue", (10, 10, 250), (0.0, 0.4), (10, 6)),
)
DECISIONS = 2


@dataclass
class Patch:
    name: str
    footprint: np.ndarray
    top: float
    attributes: dict[str, Any] = field(default_factory=dict)


class ToyTask:
    """Taking a patch pays its two sub-rewards and removes it; the bare table pays nothing; an episode is two
    decisions.
    """

    REWARD_COMPONENTS = ("left", "right")
    BACKGROUND = "table"
    METRICS = ("distance_m",)
    backends = {"simulation": "toy", "rendering": "toy"}  # noqa: RUF012
    frame_rate = 1.0

    def __init__(self, weights: dict[str, float] | None = None, first: tuple[int, ...] = (0, 1, 2)) -> None:
        self.weights = np.array([(weights or {}).get(name, 1.0) for name in self.REWARD_COMPONENTS])
        self.first = first
        self.seconds = {"simulate": 0.0, "render": 0.0}
        self.frames: list[np.ndarray] = []
        self.present: set[int] = set()
        self.made = 0

    @property
    def workspace_bounds(self) -> np.ndarray:
        return np.array([[0, SIZE * CELL], [0, SIZE * CELL], [-0.01, 1]])

    @property
    def pixel_size(self) -> float:
        return CELL

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        self.present, self.made = set(self.first), 0
        self.shade = np.random.default_rng(seed).uniform(0.9, 1.0)
        return self._observation(), {}

    def step(
        self, action: np.ndarray
    ) -> tuple[dict[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        column, row = (int(value / CELL) for value in action[:2])
        available = max([float(self.weights @ PATCHES[i][2]) for i in self.present], default=0.0)
        taken = next(
            (i for i in self.present if 0 <= row - PATCHES[i][3][0] < EDGE and 0 <= column - PATCHES[i][3][1] < EDGE),
            None,
        )
        components = np.array(PATCHES[taken][2]) if taken is not None else np.zeros(2)
        self.present.discard(taken)
        self.made += 1
        info = {
            "reward_components": torch.tensor(components, dtype=torch.float32)[None],
            "reward_available": torch.tensor([available]),
            "distance_m": torch.tensor([0.0]),
        }
        reward = torch.tensor([float(self.weights @ components)])
        return self._observation(), reward, torch.tensor([self.made >= DECISIONS]), torch.tensor([False]), info

    def reachable(self, points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), dtype=bool)

    def scene_objects(self) -> list[Patch]:
        corners = np.array([[0, 0], [EDGE, 0], [EDGE, EDGE], [0, EDGE]]) * CELL
        return [
            Patch(
                f"{PATCHES[i][0]} patch", corners + np.array(PATCHES[i][3][::-1]) * CELL, 0.0, {"color": PATCHES[i][0]}
            )
            for i in sorted(self.present)
        ]

    def exact_values(self, gamma: float) -> np.ndarray:
        exact = exact_values(tuple(sorted(self.present)), self.made, gamma, tuple(self.weights))
        return np.array([exact[i] for i in sorted(self.present)]).reshape(-1, len(self.REWARD_COMPONENTS))

    def oracle_point(self) -> np.ndarray:
        best = max(self.present, key=lambda i: float(self.weights @ PATCHES[i][2]))
        row, column = PATCHES[best][3]
        return np.array([(column + EDGE / 2) * CELL, (row + EDGE / 2) * CELL, 0.0])

    def close(self) -> None:
        pass

    def _observation(self) -> dict[str, Any]:
        color = np.full((1, SIZE, SIZE, 3), 90, dtype=np.uint8)
        for i in self.present:
            row, column = PATCHES[i][3]
            color[0, row : row + EDGE, column : column + EDGE] = PATCHES[i][1]
        # One image pixel per cell: straight down from above the middle, image right along x and image down along y.
        focal = CAMERA_HEIGHT / CELL
        intrinsics = torch.tensor([[[focal, 0, (SIZE - 1) / 2], [0, focal, (SIZE - 1) / 2], [0, 0, 1]]])
        camera_to_world = torch.eye(4)
        camera_to_world[:3, :3] = torch.tensor([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]])
        middle = SIZE * CELL / 2
        camera_to_world[:3, 3] = torch.tensor([middle, middle, CAMERA_HEIGHT])
        shaded = torch.from_numpy((color * self.shade).astype(np.uint8))
        return {
            "sensor_data": {"above": {"rgb": shaded, "depth": torch.full((1, SIZE, SIZE, 1), CAMERA_HEIGHT)}},
            "sensor_param": {
                "above": {"intrinsic_cv": intrinsics, "extrinsic_cv": torch.linalg.inv(camera_to_world)[None, :3]}
            },
        }


def exact_values(
    present: tuple[int, ...], made: int, gamma: float, weights: tuple[float, float] = (1.0, 1.0)
) -> dict[int, np.ndarray]:
    """Q*_k of taking each present patch, from all orders in which patches can be taken: ``{patch: [K]}``."""
    values = {}
    for taken in present:
        rest = tuple(i for i in present if i != taken)
        plans = [order for n in range(DECISIONS - made) for order in permutations(rest, n)]
        returns = [
            sum((gamma ** (t + 1) * np.array(PATCHES[i][2]) for t, i in enumerate(plan)), np.zeros(2)) for plan in plans
        ]
        best = max(returns, key=lambda r: float(np.dot(weights, r)))
        values[taken] = np.array(PATCHES[taken][2]) + best
    return values
