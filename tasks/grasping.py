"""Grasping: a UR5e with a suction cup sorts out cubes from bowls, the best color first.

Task Description:
    Three calibrated RGB-D cameras look at cubes and bowls on a table. The agent picks a cell of the heightmap; the
    primitive moves the cup above the 3-D point behind it, steps down until contact, tries the suction, lifts, and puts
    what hangs on the cup into a bin.

Randomizations (all from the reset's seed):
    Number, kinds, colors, places and yaws of the objects (at least one cube), a shift of each one's color, direction
    and strength of the light, the noise of the depth images. A layout with an object that the arm cannot reach is drawn
    again.

Episode:
    Ends when no cube is left on the table, and where ``failure`` says so at the first attempt that lifts nothing;
    truncated after ``attempts`` decisions.

Reward components:
    ``shape``: 1 if a cube was lifted and brought to the bin; a bowl, a leaking edge or a cube that was dropped pays 0.
    ``color``: rank of the color of the object that was tried, lifted or not: red 0, orange 1/5, … purple 1.
    The bare table pays nothing.

Robot:
    It waits beside the table, over the bin, where it hides nothing of the table from any camera.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.types import DefaultMaterialsConfig, SceneConfig, SimConfig

from . import oracle, workcell
from .agents.ur5e import cup_reach, joints_at
from .layouts import reachable_layout
from .primitives import Arm, pick
from .settings import Within, checked
from .suction import Suction, felt, seals
from .tabletop import FRICTION, Thing, body_of, entity, pose_of
from .truth import Known
from .workcell import BIN, BOUNDS, HOME_HEIGHT, PIXEL_SIZE

# Objects are at rest when none is faster (m/s); they get this many simulation steps to come to rest.
STILL, SETTLE_STEPS = 0.002, 400


@register_env("XQMapGrasping-v1", max_episode_steps=None)
class GraspingEnv(Known):
    """See the head of this file.

    Args:
        objects: fewest and most objects of a scene.
        layout: ``"spread"`` over the table, ``"cluttered"`` around a random place, or ``"stacked"``: most cubes stand
            two by two.
        failure: what follows an attempt that lifts nothing: it ``"ends"`` the episode; the object ``"stays"``; a bowl
            that was tried is ``"removed"``.
        seal: ``"rim"``: the cup's whole rim must lie on the touched body; ``"touch"``: touching a cube is enough, as in
            Ravens.
        light: how far the light varies, 0 (not at all) to 2.
        tint: most that is added to or taken from an object's red, green and blue, 8-bit.
        depth_noise: standard deviation of the depth images' noise, m.
        hover: height of the cup over the table on its way, m.
        attempts: decisions after which an episode is truncated.
        control_steps: the most a pick may take (100 a second).
        kwargs: of :class:`.base.DecisionEnv`.

    ``reset(options={"things": [...]})`` puts these objects (``Thing.to_dict()``) in the place of the drawn ones and
    leaves all else as the seed has it: the way to see the same table with one object recolored, reshaped or gone.

    Raises:
        SettingError: if a setting is not what its annotation says.
        ValueError: if no layout within the arm's reach is found.
    """

    REWARD_COMPONENTS = ("shape", "color")
    BACKGROUND = "table"
    METRICS = ("touched", "sealed", "slip_mm", "control_steps", "layouts_rejected")
    SUPPORTED_ROBOTS = ["xqmap_ur5e"]  # noqa: RUF012 (ManiSkill's own declaration)

    @checked
    def __init__(
        self,
        *,
        objects: Annotated[tuple[int, int], Within(1, 30)],
        layout: Literal["spread", "cluttered", "stacked"],
        seal: Literal["rim", "touch"],
        light: Annotated[float, Within(0.0, 2.0)],
        tint: Annotated[float, Within(0.0, 255.0)],
        depth_noise: Annotated[float, Within(0.0, 0.1)],
        hover: Annotated[float, Within(0.09, 0.4)],
        attempts: Annotated[int, Within(1, 10_000)],
        control_steps: Annotated[int, Within(1, 100_000)],
        failure: oracle.Failure = "stays",  # what agents were trained with that do not say
        **kwargs: Any,
    ) -> None:
        self.object_range, self.layout, self.seal, self.light, self.tint = objects, layout, seal, light, tint
        self.depth_noise, self.hover, self.attempts, self.control_steps = depth_noise, hover, attempts, control_steps
        self.failure, self._failed = failure, False
        self._things: dict[sapien.Entity, Thing] = {}
        self._binned: list[sapien.Entity] = []
        self._made = self.layouts_rejected = 0
        # A scene built anew is the same to the last bit; one that is reused remembers, in the order of its contacts,
        # what was there before.
        super().__init__(robot_uids="xqmap_ur5e", reconfiguration_freq=1, **kwargs)

    # -- the world -----------------------------------------------------------------------------------------------------

    @property
    def workspace_bounds(self) -> np.ndarray:
        """``[3, 2]``, m."""
        return BOUNDS

    @property
    def pixel_size(self) -> float:
        """Edge of a heightmap cell, m."""
        return PIXEL_SIZE

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(
            sim_freq=200,
            control_freq=100,
            scene_config=SceneConfig(contact_offset=0.002, solver_position_iterations=8),
            default_materials_config=DefaultMaterialsConfig(FRICTION, FRICTION, 0.0),
        )

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return workcell.cameras()

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        return workcell.onlooker()

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        # The base frame of the arm's published table is turned against the table's.
        super()._load_agent(options, sapien.Pose(q=[0, 0, 0, 1]))
        self.suction = Suction(self.agent.tcp)
        self.arm = Arm(
            self.agent, lambda target: self.control_step(target[None]), 1 / self.control_freq, self.control_steps
        )
        self._home = joints_at(np.array([[*BIN, HOME_HEIGHT]]), np.zeros(6))[0]

    def _load_lighting(self, options: dict[str, Any]) -> None:
        # Without shadows: they would treble the time of a picture.
        self._sun = self.scene.sub_scenes[0].add_directional_light([0, 0, -1], [1, 1, 1])

    def _load_scene(self, options: dict[str, Any]) -> None:
        workcell.build(self.scene)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        # A generator of its own, so that scene and noise depend on the reset's seed alone.
        rng = self._rng = np.random.RandomState(int(self._episode_seed[0]))
        count = rng.randint(self.object_range[0], self.object_range[1] + 1)
        drawn, self.layouts_rejected = reachable_layout(rng, count, self.layout, self.tint, self.hover, self._home)
        given = options.get("things")
        self._put([Thing(**thing) for thing in given] if given is not None else drawn)
        slant = self.light * rng.uniform(-0.5, 0.5, 2)
        self._sun.entity.set_pose(sapien.Pose(q=sapien.math.shortest_rotation([1, 0, 0], [*slant, -1])))
        self._sun.color = [2.0 * (1 + self.light * rng.uniform(-0.25, 0.25))] * 3
        self.scene.sub_scenes[0].set_ambient_light([0.35 * (1 + self.light * rng.uniform(-0.25, 0.25))] * 3)
        robot = self.agent.robot._objs[0]
        robot.set_qpos(self._home)
        robot.set_qvel(np.zeros(6))
        self.agent.controller.set_action(np.concatenate((self._home, np.zeros(6))))
        self.arm.joints, self._made, self._failed = self._home, 0, False
        self._settle()

    def _put(self, things: list[Thing]) -> None:
        self._things, self._binned = {entity(thing): thing for thing in things}, []
        for built in self._things:
            self.scene.sub_scenes[0].add_entity(built)

    def _settle(self) -> None:
        bodies = [body_of(built) for built in self._things]
        for step in range(SETTLE_STEPS):
            self.scene.step()
            if step > 10 and all(np.linalg.norm(body.linear_velocity) < STILL for body in bodies):
                return

    def get_obs(self, *args: Any, **kwargs: Any) -> Any:
        """ManiSkill's observation; with ``depth_noise`` the depth images (m) are noisy."""
        observation = super().get_obs(*args, **kwargs)
        if self.depth_noise > 0:
            for image in observation["sensor_data"].values():
                noise = self._rng.normal(0, 1000 * self.depth_noise, image["depth"].shape).round()
                image["depth"] = image["depth"] + torch.from_numpy(noise.astype(np.int16))
        return observation

    # -- the primitive -------------------------------------------------------------------------------------------------

    def reachable(self, points: np.ndarray) -> np.ndarray:
        """``[M]`` bool: whether the cup, pointing down, gets to the points ``[M, 3]`` and above them."""
        far = np.hypot(points[:, 0], points[:, 1])
        return far <= np.minimum(cup_reach(points[:, 2]), cup_reach(self.hover))

    def run_primitive(self, point: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        """Picks at ``point`` ``[3]`` (m)."""
        self._made += 1
        in_play = self._on_table()
        attempt = pick(
            self.arm,
            self.suction,
            np.maximum(point, (-np.inf, -np.inf, 0)),
            self.hover,
            self._home,
            self._feel,
            self._seals,
        )
        thing = in_play.get(attempt.touched) if attempt.touched is not None else None
        if thing is not None and attempt.delivered:
            self._binned.append(attempt.touched)
            del self._things[attempt.touched]
        elif thing is not None and thing.kind == "bowl" and self.failure == "removed":
            self.scene.sub_scenes[0].remove_entity(attempt.touched)
            del self._things[attempt.touched]
        self._settle()
        self._failed = thing is None or thing.kind != "cube" or not attempt.delivered
        components = {
            "shape": float(not self._failed),
            "color": thing.rank if thing is not None else 0.0,
        }
        metrics = {
            "touched": float(thing is not None),
            "sealed": float(attempt.sealed),
            "slip_mm": 1000 * attempt.slip,
            "control_steps": float(attempt.steps),
            "layouts_rejected": float(self.layouts_rejected),
        }
        return components, metrics

    def _feel(self) -> sapien.Entity | None:
        return felt(self.agent.cup, self.scene.px.get_contacts())

    def _seals(self, touched: sapien.Entity) -> bool:
        thing = self._things.get(touched)
        if thing is None:
            return False
        if self.seal == "touch":
            return thing.kind == "cube"
        return seals(thing.kind, pose_of(touched), self.arm.tip)

    def episode_over(self) -> tuple[bool, bool]:
        """Terminated when no cube is left on the table or a failure ends it, truncated after ``attempts`` decisions."""
        over = not any(thing.kind == "cube" for thing in self._on_table().values())
        over = over or (self.failure == "ends" and self._failed)
        return over, not over and self._made >= self.attempts
