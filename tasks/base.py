"""What the worlds share: a ManiSkill environment in which one ``step`` is one whole decision."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from pydantic import Field

from .settings import SettingError, Within, checked, checks

# What is the same in all worlds, of ManiSkill's own settings.
SETTLED = {"num_envs": 1, "obs_mode": "rgb+depth", "reward_mode": "sparse", "sim_backend": "physx_cpu"}
BACKENDS = r"^(auto|(sapien_)?cpu|(gpu|cuda|sapien_cuda)(:\d+)?)$"
# Frames a second of a film, where the control steps are that many.
FILM_RATE = 25


@dataclass
class SceneObject:
    """One thing in the scene as the world itself knows it: a name, its outline ``[P, 2]`` (m) from above, its top (m),
    its properties.
    """

    name: str
    footprint: np.ndarray
    top: float
    attributes: dict[str, Any] = field(default_factory=dict)


class DecisionEnv(BaseEnv):
    """A world in which an action is a 3-D point and a step runs a motion primitive there, to its end.

    A task gives ``REWARD_COMPONENTS``, ``BACKGROUND``, ``METRICS``, ManiSkill's usual hooks (``_load_scene``,
    ``_initialize_episode``, ``_default_sensor_configs``) and four methods of its own: :meth:`run_primitive`,
    :meth:`highest_reward`, :meth:`scene_objects` and :meth:`oracle_point`.

    Args:
        weights: w_k by component name, 0 or more; R = Σ_k w_k r_k. A component that is not named weighs 1.
        render_backend: ``"auto"`` draws on a GPU where CUDA sees one, else on the CPU.
        robot_uids: ManiSkill's name of the robot; ``"none"`` for a world without one.
        render_mode: with ``"rgb_array"`` every decision is filmed.
        kwargs: ManiSkill's own, but for those that are settled here.

    Attributes:
        frames: the film of the last decision, ``[h, w, 3]`` uint8 each.

    Raises:
        SettingError: if a setting is not what its annotation says, or there is none of that name.
    """

    REWARD_COMPONENTS: tuple[str, ...] = ()
    BACKGROUND: str = "ground"
    METRICS: tuple[str, ...] = ()
    SUPPORTED_REWARD_MODES = ("sparse", "none")

    @checked
    def __init__(
        self,
        *,
        weights: Annotated[
            Mapping[str, Annotated[float, Within(0.0, 1e9)]] | None, "numbers from 0 on by component, or null"
        ] = None,
        render_backend: Annotated[str, Field(pattern=BACKENDS), "auto, cpu, gpu or sapien_cuda:NUMBER"] = "auto",
        render_mode: Literal["rgb_array", "human", "sensors", "all", None] = None,
        robot_uids: str = "none",
        **kwargs: Any,
    ) -> None:
        if unknown := set(weights or {}) - set(self.REWARD_COMPONENTS):
            raise SettingError(
                "weights", f"names {min(unknown)!r}, which is none of {', '.join(self.REWARD_COMPONENTS)}"
            )
        own = checks(BaseEnv.__init__)
        for name, value in kwargs.items():
            if name in SETTLED or name not in own:
                raise SettingError(name, f"is no setting of {type(self).__name__}")
            own[name](name, value)
        self.weights = torch.tensor([float((weights or {}).get(name, 1.0)) for name in self.REWARD_COMPONENTS])
        self.seconds = {"simulate": 0.0, "render": 0.0}
        self._outcome: dict[str, torch.Tensor] = {}
        self._over = (False, False)
        self.frames: list[np.ndarray] = []
        self._control_steps = 0
        if render_backend == "auto":
            render_backend = "gpu" if torch.cuda.is_available() else "cpu"
        super().__init__(
            **SETTLED, render_backend=render_backend, render_mode=render_mode, robot_uids=robot_uids, **kwargs
        )
        # Building the world and drawing the first frame, which compiles shaders, are no part of a decision.
        self.seconds = {"simulate": 0.0, "render": 0.0}
        self.single_action_space = gym.spaces.Box(-np.inf, np.inf, (3,), np.float32)
        self.action_space = gym.spaces.Box(-np.inf, np.inf, (1, 3), np.float32)

    # -- what a task gives ---------------------------------------------------------------------------------------------

    def run_primitive(self, point: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        """Runs the motion at ``point`` ``[3]`` (m) with :meth:`control_step`.

        Returns:
            The sub-rewards r_k in [0, 1] by component name, and the numbers that ``METRICS`` names.
        """
        raise NotImplementedError

    def highest_reward(self) -> float:
        """The highest Σ_k w_k r_k any action would have in the present state, from the world's own truth."""
        raise NotImplementedError

    def episode_over(self) -> tuple[bool, bool]:
        """``(terminated, truncated)`` after the decision that was just run."""
        return True, False

    def scene_objects(self) -> list[SceneObject]:
        """The objects of the present state."""
        raise NotImplementedError

    def oracle_point(self) -> np.ndarray:
        """``[3]``, m: a point whose choice has the highest reward available."""
        raise NotImplementedError

    def reachable(self, points: np.ndarray) -> np.ndarray:
        """``[M]`` bool: whether the primitive can be tried at each of the points ``[M, 3]``."""
        return np.ones(len(points), dtype=bool)

    @property
    def backends(self) -> dict[str, str]:
        """What simulates and what draws the world, by ManiSkill's names."""
        return {"simulation": self.backend.sim_backend, "rendering": self.backend.render_backend}

    # -- ManiSkill's side ----------------------------------------------------------------------------------------------

    def control_step(self, action: Any = None) -> None:
        """One control step: ManiSkill's own step, without observation and reward.

        Args:
            action: ``[1, n]``, of the robot's controller; None (and always where there is no robot): time goes by.
        """
        if action is not None:
            # To the controller itself: the agent's check for NaN makes numpy warn of torch's tensors at every step.
            self.agent.controller.set_action(torch.as_tensor(action, dtype=torch.float32))
        super()._step_action(None)
        self._control_steps += 1
        if self.render_mode == "rgb_array" and self._control_steps % self._steps_per_frame == 0:
            self.frames.append(self.render_rgb_array()[0].numpy().copy())

    @property
    def _steps_per_frame(self) -> int:
        return max(1, round(self.control_freq / FILM_RATE))

    @property
    def frame_rate(self) -> float:
        """Of :attr:`frames`, per second of simulated time."""
        return self.control_freq / self._steps_per_frame

    def _step_action(self, action: Any) -> torch.Tensor:
        point = np.asarray(action, dtype=np.float64).reshape(3)
        if not np.isfinite(point).all():
            raise ValueError(f"an action is a point of three finite numbers (m), not {point.tolist()}")
        start = time.perf_counter()
        self.frames, self._control_steps = [], 0
        available = self.highest_reward()
        components, metrics = self.run_primitive(point)
        values = torch.tensor([[float(components[name]) for name in self.REWARD_COMPONENTS]])
        self._over = self.episode_over()
        self._outcome = {
            "reward_components": values,
            "reward_available": torch.tensor([available], dtype=torch.float32),
            **{name: torch.tensor([float(value)]) for name, value in metrics.items()},
        }
        self.seconds["simulate"] += time.perf_counter() - start
        return torch.as_tensor(point, dtype=torch.float32)[None]

    def reset(self, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new scene (ManiSkill's reset); no outcome of an earlier decision survives it."""
        self._outcome, self._over = {}, (False, False)
        start, rendered = time.perf_counter(), self.seconds["render"]
        result = super().reset(seed=seed, options=options)
        self.seconds["simulate"] += time.perf_counter() - start - (self.seconds["render"] - rendered)
        return result

    def get_obs(self, *args: Any, **kwargs: Any) -> Any:
        """ManiSkill's observation: the cameras' images and calibration."""
        start = time.perf_counter()
        observation = super().get_obs(*args, **kwargs)
        self.seconds["render"] += time.perf_counter() - start
        return observation

    def _get_obs_agent(self) -> dict[str, Any]:
        return super()._get_obs_agent() if self.agent is not None else {}

    def get_state_dict(self) -> dict[str, Any]:
        """ManiSkill's state of the simulation, and of the robot's controller where there is a robot."""
        return super().get_state_dict() if self.agent is not None else self.scene.get_sim_state()

    def evaluate(self) -> dict[str, torch.Tensor]:
        """The last decision's outcome as named tensors, for reward, observation and info alike."""
        return dict(self._outcome)

    def compute_sparse_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """R = Σ_k w_k r_k, ``[1]``."""
        return (info["reward_components"] * self.weights).sum(-1)

    def step(self, action: Any) -> tuple[Any, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """One decision: the primitive runs at the point ``action`` ``[3]`` (world, m) to its end."""
        observation, reward, _, _, info = super().step(action)
        terminated, truncated = (torch.tensor([flag]) for flag in self._over)
        return observation, reward, terminated, truncated, info
