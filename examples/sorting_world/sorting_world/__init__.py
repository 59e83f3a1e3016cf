"""Parcels on a table: taking one pays for its urgency, its size and its height. All of it can be seen from above.

A world for xqmap is any class with these attributes and methods (``xqmap.envs.protocol.Task``); there is nothing to
inherit from, and no simulator is needed where, as here, the motion does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

EDGE, CELL = 2.0, 0.05  # of the table and of a cell of the heightmap, m
CELLS = round(EDGE / CELL)
CAMERA = 20.0  # height above the table, m
URGENCY = {"red": 1.0, "yellow": 0.5, "blue": 0.0}
COLORS = {"red": (200, 50, 40), "yellow": (220, 190, 50), "blue": (50, 80, 190)}
LEAST, MOST = 0.2, 0.5  # edge of a parcel, m
TALLEST = 0.5  # m


@dataclass
class Parcel:
    """A box: its middle, the edge of its square top and its height in metres."""

    color: str
    middle: np.ndarray
    edge: float
    top: float

    @property
    def name(self) -> str:
        return f"{self.color} parcel"

    @property
    def footprint(self) -> np.ndarray:
        return self.middle + self.edge / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

    @property
    def attributes(self) -> dict[str, Any]:
        return {"color": self.color, "edge_m": round(self.edge, 2), "height_m": round(self.top, 2)}

    @property
    def pays(self) -> np.ndarray:
        """The sub-rewards of taking it, each from 0 to 1."""
        return np.array([URGENCY[self.color], (self.edge - LEAST) / (MOST - LEAST), self.top / TALLEST])


class SortingWorld:
    """Taking a parcel removes it; the bare table pays nothing.

    Args:
        weights: w_k by component, from the task's yaml.
        parcels: on the table at first.
        decisions: in an episode.
    """

    REWARD_COMPONENTS = ("urgency", "size", "height")
    BACKGROUND = "table"
    METRICS = ("parcels_left",)
    backends = {"simulation": "none", "rendering": "none"}
    frame_rate = 1.0
    pixel_size = CELL
    workspace_bounds = np.array([[0, EDGE], [0, EDGE], [-0.01, 1.0]])

    def __init__(self, weights: dict[str, float], parcels: int, decisions: int) -> None:
        self.weights = np.array([weights.get(name, 1.0) for name in self.REWARD_COMPONENTS])
        self.count, self.decisions = parcels, decisions
        self.seconds = {"simulate": 0.0, "render": 0.0}
        self.frames: list[np.ndarray] = []
        self.parcels: list[Parcel] = []

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        rng = np.random.default_rng(seed)
        self.made, self.parcels = 0, []
        while len(self.parcels) < self.count:
            edge, middle = rng.uniform(LEAST, MOST), rng.uniform(MOST / 2, EDGE - MOST / 2, 2)
            # With room between them: each stands alone.
            if all(np.abs(middle - other.middle).max() > (edge + other.edge) / 2 + 0.05 for other in self.parcels):
                color = str(rng.choice(list(COLORS)))
                self.parcels.append(Parcel(color, middle, edge, rng.uniform(0.1, TALLEST)))
        return self._observation(), {}

    def step(self, action: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        point = np.asarray(action)[:2]
        available = max((float(self.weights @ parcel.pays) for parcel in self.parcels), default=0.0)
        taken = next((p for p in self.parcels if np.abs(point - p.middle).max() <= p.edge / 2), None)
        parts = taken.pays if taken else np.zeros(len(self.REWARD_COMPONENTS))
        self.parcels = [parcel for parcel in self.parcels if parcel is not taken]
        self.made += 1
        info = {
            "reward_components": torch.tensor(parts, dtype=torch.float32)[None],
            "reward_available": torch.tensor([available]),
            "parcels_left": torch.tensor([float(len(self.parcels))]),
        }
        over = self.made >= self.decisions or not self.parcels
        reward = torch.tensor([float(self.weights @ parts)])
        return self._observation(), reward, torch.tensor([over]), torch.tensor([False]), info

    def reachable(self, points: np.ndarray) -> np.ndarray:
        return np.ones(len(points), dtype=bool)

    def scene_objects(self) -> list[Parcel]:
        return self.parcels

    def oracle_point(self) -> np.ndarray:
        best = max(self.parcels, key=lambda parcel: float(self.weights @ parcel.pays))
        return np.array([*best.middle, best.top])

    def close(self) -> None:
        pass

    def _observation(self) -> dict[str, Any]:
        """What a camera straight above the table sees: one pixel per cell, image right along x, image up along y."""
        focal, middle = CAMERA / CELL, EDGE / 2
        at = (np.arange(CELLS) + 0.5) * CELL - middle
        color = np.full((CELLS, CELLS, 3), 120, dtype=np.uint8)
        depth = np.full((CELLS, CELLS), CAMERA, dtype=np.float32)
        for parcel in sorted(self.parcels, key=lambda parcel: parcel.top):
            # Where the rays of the pixels pass the height of its top.
            closer = 1 - parcel.top / CAMERA
            x, y = at * closer + middle - parcel.middle[0], -at * closer + middle - parcel.middle[1]
            on_top = (np.abs(y)[:, None] <= parcel.edge / 2) & (np.abs(x)[None] <= parcel.edge / 2)
            color[on_top], depth[on_top] = COLORS[parcel.color], CAMERA - parcel.top
        intrinsics = torch.tensor([[[focal, 0, (CELLS - 1) / 2], [0, focal, (CELLS - 1) / 2], [0, 0, 1]]])
        world_to_camera = torch.tensor([[[1.0, 0, 0, -middle], [0, -1, 0, middle], [0, 0, -1, CAMERA]]])
        rgb, metres = torch.from_numpy(color)[None], torch.from_numpy(depth)[None, ..., None]
        return {
            "sensor_data": {"above": {"rgb": rgb, "depth": metres}},
            "sensor_param": {"above": {"intrinsic_cv": intrinsics, "extrinsic_cv": world_to_camera}},
        }
