"""What a world must offer so that xqmap can learn in it: a structural type, nothing to inherit from.

A task is a ManiSkill environment (``mani_skill.envs.sapien_env.BaseEnv``, CPU simulation, one scene) in which one
``step`` is one whole *decision*: the action is a 3-D point, and the task's motion primitive (land, pick) runs there to
its end.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np


class SceneObject(Protocol):
    """One thing in the scene, as the world itself knows it: for perception, baselines and tables, never for the policy.

    Attributes:
        name: what a person would call it, like ``"blue cube"`` or ``"red flat block"``.
        footprint: ``[P, 2]`` float, the corners of its convex outline seen from above, world x and y in metres.
        top: float, its highest z in metres.
        attributes: its properties by name (``{"color": "blue", "kind": "cube"}``), plain JSON values.
    """

    name: str
    footprint: np.ndarray
    top: float
    attributes: dict[str, Any]


@runtime_checkable
class Task(Protocol):
    """The world's side of the contract.

    Attributes:
        REWARD_COMPONENTS: the names of the K sub-rewards, in the order of every ``[..., K]`` tensor.
        BACKGROUND: the name of what lies where no object is (``"ground"``, ``"table"``).
        METRICS: names of further numbers in every ``info``, each ``[1]`` float, worth logging (``landing_offset_m``).
        seconds: wall-clock spent so far, by activity (``simulate``, ``render``).
        frames: the film of the last decision, ``[h, w, 3]`` uint8 each, where the world was built with
            ``render_mode="rgb_array"``.

    ``reset`` and ``step`` return ManiSkill's own observation (``sensor_data`` with ``rgb`` and ``depth`` per camera,
    whole numbers in millimetres, others in metres; ``sensor_param`` with ``intrinsic_cv`` and ``extrinsic_cv``).
    ``step`` takes the point ``[3]`` in world metres; its ``info`` carries

    - ``reward_components``: ``[1, K]`` float, the sub-rewards r_k in [0, 1], unweighted;
    - ``reward_available``: ``[1]`` float, the highest Σ_k w_k r_k any action would have had in the state the action was
      chosen in;

    and its reward is Σ_k w_k r_k.
    """

    REWARD_COMPONENTS: tuple[str, ...]
    BACKGROUND: str
    METRICS: tuple[str, ...]
    seconds: dict[str, float]
    frames: list[np.ndarray]

    @property
    def backends(self) -> dict[str, str]:
        """What simulates and what draws: ``{"simulation": "physx_cpu", "rendering": "sapien_cpu"}``."""
        ...

    @property
    def frame_rate(self) -> float:
        """Of ``frames``, per second of simulated time."""
        ...

    @property
    def workspace_bounds(self) -> np.ndarray:
        """``[3, 2]`` float, the lowest and highest world x, y, z of the heightmap, metres; may change with each
        reset.
        """
        ...

    @property
    def pixel_size(self) -> float:
        """The edge of a heightmap cell in metres."""
        ...

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """A new scene; the same seed gives the same scene."""
        ...

    def step(self, action: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Runs the primitive at the point ``action`` ``[3]``:
        ``(observation, reward, terminated, truncated, info)``.
        """
        ...

    def reachable(self, points: np.ndarray) -> np.ndarray:
        """``[M]`` bool: whether the primitive can be tried at each of the points ``[M, 3]``."""
        ...

    def scene_objects(self) -> list[Any]:
        """The :class:`SceneObject` list of the present state."""
        ...

    def oracle_point(self) -> np.ndarray:
        """``[3]`` float: a point whose choice has the highest reward available, from the world's own truth."""
        ...

    def close(self) -> None:
        """Frees the simulator."""
        ...


@runtime_checkable
class Solvable(Protocol):
    """What a world offers that can be solved exactly: for checking explanations, never for the policy. Optional."""

    def exact_values(self, gamma: float) -> np.ndarray | None:
        """``[objects, K]`` float: unweighted Q*_k of taking each of ``scene_objects()`` now and then doing what is best
        for Σ_k w_k r_k.

        Args:
            gamma: discount per decision.

        Returns:
            None where, as it is set up, this world's future is not known exactly.
        """
        ...


@runtime_checkable
class Advised(Protocol):
    """What a world offers that knows how others would choose: baselines of its own, never for the policy. Optional.

    Attributes:
        ADVISERS: their names; one that is called ``"oracle"`` stands in for the oracle of the highest reward.
    """

    ADVISERS: tuple[str, ...]

    def advice(self, name: str, gamma: float) -> np.ndarray:
        """``[3]`` float: the point that an adviser would choose in the present state.

        Args:
            name: one of ``ADVISERS``.
            gamma: discount per decision.
        """
        ...
