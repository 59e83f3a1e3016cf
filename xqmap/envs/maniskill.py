"""A ManiSkill world as a torchrl environment: heightmaps in, pixels out, rewards by component."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from xqmap import keys
from xqmap.envs.guard import guarded
from xqmap.envs.heightmap import PixelGrid, heightmap, metres
from xqmap.envs.protocol import Task
from xqmap.errors import UserError, WorldError

if TYPE_CHECKING:
    from xqmap.explanations import Decision

# How far R may be from Σ w_k r_k: what single precision rounds, and no more.
_SAME_SUM = 1e-4


class ManiSkillEnv(EnvBase):
    """One decision per step: the action is a cell of the heightmap, the task's primitive runs at the 3-D point behind
    it.

    Args:
        make_task: builds the world; called here, so that the environment can be sent to a worker process before it
            exists.
        first_scene: seed of the first scene; each reset that is not told otherwise takes the next one.
        limit: seconds a decision or reset may take; None for no limit.
        weights: w_k by component name, in the order that the world is to have: it is held to both, and to R = Σ w_k r_k
            at every step. None holds it to neither.

    Raises:
        UserError: if the world has other components, or the same in another order.

    Attributes:
        task: the world.
        grid: the cells of the present heightmap in world metres.
        scene_seed: seed of the present scene.
        unfinished: actions that the next reset plays in its scene: how an episode is picked up where it was left.
        seconds: wall-clock spent so far, by activity (``simulate``, ``render``, ``fuse``).
    """

    def __init__(
        self,
        make_task: Callable[[], Task],
        first_scene: int = 0,
        limit: float | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([]))
        self.task = make_task()
        self.components = tuple(self.task.REWARD_COMPONENTS)
        self._weights = None if weights is None else torch.tensor(list(weights.values()), dtype=torch.float64)
        if weights is not None and tuple(weights) != self.components:
            self.close()
            raise UserError(
                f"task.components={list(weights)}, but the world's REWARD_COMPONENTS are {list(self.components)}: give "
                "the same names in the same order"
            )
        self.metric_names = tuple(self.task.METRICS)
        self.next_scene = first_scene
        self.scene_seed = first_scene
        self.unfinished: list[int] = []
        self._limit = limit
        self._fuse_seconds = 0.0
        self.grid = self._grid()
        self._heightmap = torch.zeros(4, *self.grid.shape)
        cells = self.grid.shape[0] * self.grid.shape[1]
        count = len(self.components)
        self.observation_spec = Composite(
            {
                keys.HEIGHTMAP: Unbounded((4, *self.grid.shape), dtype=torch.float32),
                keys.ACTION_MASK: Binary(cells, (cells,), dtype=torch.bool),
                keys.REWARD_COMPONENTS: Unbounded((count,), dtype=torch.float32),
                keys.REWARD_AVAILABLE: Unbounded((1,), dtype=torch.float32),
                **{name: Unbounded((1,), dtype=torch.float32) for name in self.metric_names},
            }
        )
        self.action_spec = Categorical(cells, (), dtype=torch.int64)
        self.reward_spec = Unbounded((1,), dtype=torch.float32)
        self.done_spec = Composite(
            {name: Binary(1, (1,), dtype=torch.bool) for name in (keys.DONE, keys.TERMINATED, keys.TRUNCATED)}
        )

    @property
    def seconds(self) -> dict[str, float]:
        """Wall-clock seconds spent so far in simulating, rendering and fusing."""
        return {**self.task.seconds, "fuse": self._fuse_seconds}

    def point(self, action: int | Tensor) -> Tensor:
        """``[3]``, world metres: the point behind the cell ``action`` of the present heightmap."""
        columns = self.grid.shape[1]
        row, column = divmod(int(action), columns)
        return self.grid.to_point(torch.tensor([row, column]), self._heightmap[3, row, column])

    def action_at(self, point: Any) -> int:
        """The cell ``row · W + column`` nearest to the world point ``[≥2]`` (m)."""
        rows, columns = self.grid.shape
        row, column = self.grid.to_pixel(torch.as_tensor(np.asarray(point), dtype=torch.float64)).tolist()
        return min(max(row, 0), rows - 1) * columns + min(max(column, 0), columns - 1)

    def cell(self, decision: Decision) -> int:
        """The action that a decision chose, row · W + column.

        Raises:
            UserError: if it chose no cell of a map.
        """
        if decision.selected.pixel is None:
            raise UserError("this decision chose no cell of a map: play one of the cells, row · W + column")
        row, column = decision.selected.pixel
        return row * self.grid.shape[1] + column

    def play(self, state: TensorDictBase, action: Decision | int) -> TensorDictBase:
        """Carries an action out.

        Args:
            state: the present one.
            action: a decision, whose choice is played; or a cell, row · W + column.

        Returns:
            The state after it, with ``reward``, ``reward_components`` and ``done``.
        """
        chosen = action if isinstance(action, int) else self.cell(action)
        after: TensorDictBase = self.step(state.clone(False).set(keys.ACTION, torch.tensor(chosen)))["next"]
        return after

    def rewards(self, state: TensorDictBase) -> dict[str, float]:
        """What the action before ``state`` was paid, by component."""
        return dict(zip(self.components, state[keys.REWARD_COMPONENTS].tolist(), strict=True))

    def _grid(self) -> PixelGrid:
        return PixelGrid(np.asarray(self.task.workspace_bounds).tolist(), self.task.pixel_size)

    def _observe(self, observation: dict[str, Any], over: bool = False) -> dict[str, Tensor]:
        # When the episode is over, nobody chooses: an aircraft that tipped over may well look into the sky.
        start = time.perf_counter()
        self.grid = self._grid()
        images, parameters = observation["sensor_data"], observation["sensor_param"]
        names = list(images)
        color = torch.cat([torch.as_tensor(images[name]["rgb"]) for name in names])
        depth = torch.cat([metres(images[name]["depth"]) for name in names])[..., 0]
        intrinsics = torch.cat([torch.as_tensor(parameters[name]["intrinsic_cv"]) for name in names]).float()
        world_to_camera = torch.cat([torch.as_tensor(parameters[name]["extrinsic_cv"]) for name in names]).float()
        fused = heightmap(color[..., :3], depth, intrinsics, _inverse(world_to_camera), self.grid)
        # Rounded as the replay buffer stores it, so that the policy learns from what it sees.
        fused[3] = fused[3].half().float()
        if not bool(fused.isfinite().all()):
            raise WorldError("the heightmap holds NaN or infinite values: a camera or its calibration is broken")
        self._heightmap = fused
        cells = np.stack(np.meshgrid(*map(np.arange, self.grid.shape), indexing="ij"), axis=-1).reshape(-1, 2)
        points = self.grid.to_point(torch.from_numpy(cells), fused[3].reshape(-1)).numpy()
        seen = (fused != 0).any(0).reshape(-1)
        if not bool(seen.any()) and not over:
            kinds = ", ".join(f"{name}: {images[name]['depth'].dtype}" for name in names)
            raise WorldError(
                "the heightmap is empty: no camera sees anything of the workspace (depth of integer types is read in "
                f"mm, of others in m; {kinds})"
            )
        mask = seen & torch.as_tensor(np.asarray(self.task.reachable(points)), dtype=torch.bool)
        self._fuse_seconds += time.perf_counter() - start
        return {keys.HEIGHTMAP: fused, keys.ACTION_MASK: mask}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        self.scene_seed, self.next_scene = self.next_scene, self.next_scene + 1
        with guarded(f"scene {self.scene_seed}", self._limit):
            observation, _ = self.task.reset(seed=self.scene_seed)
            blank = {name: torch.zeros(1) for name in (keys.REWARD_AVAILABLE, *self.metric_names)}
            state = {**self._observe(observation), keys.REWARD_COMPONENTS: torch.zeros(len(self.components)), **blank}
        played, self.unfinished = self.unfinished, []
        for action in played:
            result = self._step(TensorDict({keys.ACTION: torch.tensor(action)}))
            state = {name: result[name] for name in state}
        return TensorDict(state)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        with guarded(f"scene {self.scene_seed}", self._limit):
            return self._decide(tensordict)

    def _decide(self, tensordict: TensorDictBase) -> TensorDictBase:
        point = self.point(tensordict[keys.ACTION])
        observation, reward, terminated, truncated, info = self.task.step(point.numpy())
        flags = {keys.TERMINATED: bool(terminated), keys.TRUNCATED: bool(truncated)}
        rewards = torch.cat(
            [torch.as_tensor(part, dtype=torch.float32).reshape(-1) for part in (reward, info["reward_components"])]
        )
        if not bool(rewards.isfinite().all()):
            raise WorldError("a reward is NaN or infinite: the world is broken")
        total, parts = rewards[0].double(), rewards[1:].double()
        if len(parts) != len(self.components):
            raise WorldError(
                f"info['reward_components'] holds {len(parts)} numbers for the {len(self.components)} components "
                f"{', '.join(self.components)}: the world is broken"
            )
        if self._weights is not None and not torch.isclose(total, self._weights @ parts, rtol=1e-4, atol=_SAME_SUM):
            raise WorldError(
                f"the reward {float(total):g} is not the sum of the weighted components, "
                f"{float(self._weights @ parts):g}: the world is broken, R = Σ w_k r_k must hold at every step"
            )
        return TensorDict(
            {
                **self._observe(observation, over=any(flags.values())),
                keys.REWARD: torch.as_tensor(reward, dtype=torch.float32).reshape(1),
                keys.REWARD_COMPONENTS: torch.as_tensor(info["reward_components"], dtype=torch.float32).reshape(-1),
                keys.REWARD_AVAILABLE: torch.as_tensor(info["reward_available"], dtype=torch.float32).reshape(1),
                **{name: torch.as_tensor(info[name], dtype=torch.float32).reshape(1) for name in self.metric_names},
                **{name: torch.tensor([flag]) for name, flag in flags.items()},
                keys.DONE: torch.tensor([any(flags.values())]),
            }
        )

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.next_scene = seed

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Frees the simulator."""
        if not self.is_closed:
            self.task.close()
        super().close(raise_if_closed=raise_if_closed)


def _inverse(world_to_camera: Tensor) -> Tensor:
    """``[N, 3 or 4, 4]`` rigid transforms → their inverses ``[N, 4, 4]``."""
    rotation, translation = world_to_camera[:, :3, :3], world_to_camera[:, :3, 3:]
    inverse = torch.eye(4).repeat(len(world_to_camera), 1, 1)
    inverse[:, :3, :3] = rotation.mT
    inverse[:, :3, 3:] = -rotation.mT @ translation
    return inverse
