"""Landing: a flying agent picks a spot of a field of blocks and touches down there.

Task Description:
    From a constant altitude the agent sees part of a field of blocks, straight down. It picks a cell of the heightmap;
    the primitive flies to above the 3-D point behind it and descends under control until the physics reports contact.

Randomizations (all from the reset's seed):
    Number, place, footprint, height and yaw of the blocks; their tops flat or inclined; green, red, blue or gray, each
    a little lighter or darker; direction and strength of the light; where over the field the agent is.

Episode:
    ``landings_per_episode`` decisions, each from a new place at the same altitude over the same field. A landing takes
    at most ``control_steps`` control steps.

Reward components (at the touched spot, the mean of the first contact's points):
    ``flatness``: 1 if θ = arccos(n·q) ≤ 5° between the vertical n and the true surface normal q there (a wall has θ =
    90°). ``color``: 1 unless what was touched is gray (the ground is).
    A time-out pays nothing, and neither does a miss: hull or rotors hit something before the foot does.

Cells:
    The camera looks from above, so the ground right behind a block stays hidden. Such cells are empty in the heightmap
    (0 high, black) and cannot be chosen: no 3-D point is known there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.types import DefaultMaterialsConfig, SceneConfig, SimConfig

from .agents.aircraft import Aircraft
from .base import DecisionEnv, SceneObject
from .blocks import MAX_TOP, Block, entity, material, sample_field
from .overview import best_place, in_view
from .settings import Within, checked

CELLS = 84
HALF_SIZE = 20.0
# Straight down, the image's right along x and its top along y.
DOWN = sapien.Pose([0, 0, -0.02], [0.5, -0.5, 0.5, 0.5])
# Between ground and heightmap floor, so that ground and unseen cells differ in height as well (m).
FLOOR = -0.05
FRICTION = 0.6
CRUISE_SPEED = 10.0
# Height over the point below which the descent is slow (m), and how slow (m/s).
SLOW_BELOW = 0.5
TOUCH_SPEED = 0.4
SETTLE_STEPS = 4
# Moving farther than this after the touch is sliding (m).
SLID = 0.1
# PhysX reports contacts a little early, and after one simulation step at most this deep (m).
CONTACT = 0.005
ON_TOP = 0.05


@dataclass(frozen=True)
class Touch:
    """The first contact: where, where the aircraft was (``[3]``, world, m), whether with its foot, with which block
    (None: the ground).
    """

    spot: np.ndarray
    aircraft: np.ndarray
    foot: bool
    block: Block | None


@register_env("XQMapLanding-v1", max_episode_steps=None)
class LandingEnv(DecisionEnv):
    """See the head of this file.

    Args:
        altitude: of the agent over the ground, m.
        pixel_size: edge of a heightmap cell, m; the map has 84 × 84.
        image_size: edge of the camera's image, pixels.
        blocks: fewest and most blocks of a field (40 × 40 m).
        incline_deg: least and greatest angle of an inclined top.
        inclined_share: share of blocks whose top is inclined.
        light: how far light and shade vary, 0 (not at all) to 2.
        landings_per_episode: decisions before the field changes.
        control_steps: the most a landing may take.
        kwargs: of :class:`DecisionEnv`.

    ``reset(options={"blocks": [...]})`` puts these blocks (``Block.to_dict()``) in the place of the drawn ones and
    leaves all else as the seed has it: the way to see the same view with one block recolored, leveled or gone.

    Raises:
        SettingError: if a setting is not what its annotation says.
    """

    REWARD_COMPONENTS = ("flatness", "color")
    BACKGROUND = "ground"
    METRICS = ("landing_offset_m", "tilt_deg", "slid", "control_steps")
    SUPPORTED_ROBOTS = ["xqmap_aircraft"]  # noqa: RUF012 (ManiSkill's own declaration)
    agent: Aircraft

    @checked
    def __init__(
        self,
        *,
        altitude: Annotated[float, Within(10.0, 30.0)],
        pixel_size: Annotated[float, Within(0.05, 2 * HALF_SIZE / CELLS)],
        image_size: Annotated[int, Within(2 * CELLS, 4096)],
        blocks: Annotated[tuple[int, int], Within(0, 200)],
        incline_deg: Annotated[tuple[float, float], Within(0.0, 45.0)],
        inclined_share: Annotated[float, Within(0.0, 1.0)],
        light: Annotated[float, Within(0.0, 2.0)],
        landings_per_episode: Annotated[int, Within(1, 10_000)],
        control_steps: Annotated[int, Within(1, 10_000)],
        **kwargs: Any,
    ) -> None:
        self.altitude, self._pixel_size, self.image_size = altitude, pixel_size, image_size
        self.block_range, self.incline_deg, self.inclined_share = blocks, incline_deg, inclined_share
        self.light, self.landings_per_episode, self.control_steps = light, landings_per_episode, control_steps
        self.blocks: list[Block] = []
        self._entities: dict[sapien.Entity, Block] = {}
        self._location = np.zeros(2)
        self._landings = 0
        self._touch: Touch | None = None
        super().__init__(robot_uids="xqmap_aircraft", **kwargs)

    # -- the world -----------------------------------------------------------------------------------------------------

    @property
    def workspace_bounds(self) -> np.ndarray:
        """``[3, 2]``, m: the part of the field in view, from just below the ground to above the highest top."""
        half = CELLS * self._pixel_size / 2
        x, y = self._location
        return np.array([[x - half, x + half], [y - half, y + half], [FLOOR, MAX_TOP + 0.5]])

    @property
    def pixel_size(self) -> float:
        """Edge of a heightmap cell, m."""
        return self._pixel_size

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(
            sim_freq=100,
            control_freq=5,
            scene_config=SceneConfig(bounce_threshold=5.0),
            default_materials_config=DefaultMaterialsConfig(FRICTION, FRICTION, 0.0),
        )

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        # Wide enough for the rim of the map at the height of the highest top.
        fov = 2 * float(np.arctan(CELLS * self._pixel_size / 2 / (self.altitude - MAX_TOP)))
        mount = self.agent.robot.links[0]
        return [
            CameraConfig(
                "down", DOWN, self.image_size, self.image_size, fov, 0.1, 32.0, mount=mount, shader_pack="minimal"
            )
        ]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        # Behind the aircraft, a little above, looking ahead and down.
        behind = sapien.Pose([-2.4, 0.0, 1.5], [np.cos(0.22), 0.0, np.sin(0.22), 0.0])
        return CameraConfig(
            "behind", behind, 960, 640, 1.1, 0.05, 200.0, mount=self.agent.robot.links[0], shader_pack="default"
        )

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, sapien.Pose([0, 0, self.altitude]))

    def _load_lighting(self, options: dict[str, Any]) -> None:
        # Without shadows: they would treble the time of a picture.
        self._sun = self.scene.sub_scenes[0].add_directional_light([0, 0, -1], [1, 1, 1])

    def _load_scene(self, options: dict[str, Any]) -> None:
        pose, half = sapien.Pose([0, 0, -0.5]), [5 * HALF_SIZE, 5 * HALF_SIZE, 0.5]
        ground = self.scene.create_actor_builder()
        ground.add_box_collision(pose, half)
        ground.add_box_visual(pose, half, material=material("gray", 0.75))
        ground.initial_pose = sapien.Pose()
        ground.build_static("ground")

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        # A generator of its own, so that scene and places depend on the reset's seed alone.
        rng = self._rng = np.random.RandomState(int(self._episode_seed[0]))
        count = rng.randint(self.block_range[0], self.block_range[1] + 1)
        shades = 1 + self.light * np.array([-0.15, 0.1])
        drawn = sample_field(rng, HALF_SIZE, count, self.incline_deg, self.inclined_share, tuple(shades))
        given = options.get("blocks")
        self.blocks = drawn if given is None else [Block(**block) for block in given]
        self._build_blocks()
        slant = self.light * rng.uniform(-0.5, 0.5, 2)
        self._sun.entity.set_pose(sapien.Pose(q=sapien.math.shortest_rotation([1, 0, 0], [*slant, -1])))
        self._sun.color = [2.2 * (1 + self.light * rng.uniform(-0.2, 0.2))] * 3
        self.scene.sub_scenes[0].set_ambient_light([0.3 * (1 + self.light * rng.uniform(-0.2, 0.2))] * 3)
        self._landings = 0
        self._fly_to_new_place()

    def _build_blocks(self) -> None:
        scene = self.scene.sub_scenes[0]
        for built in self._entities:
            scene.remove_entity(built)
        self._entities = {entity(block): block for block in self.blocks}
        for built in self._entities:
            scene.add_entity(built)

    def _fly_to_new_place(self) -> None:
        reach = HALF_SIZE - CELLS * self._pixel_size / 2
        self._location = self._rng.uniform(-reach, reach, 2)
        body = self.agent.robot._objs[0]
        body.set_root_pose(sapien.Pose([*self._location, self.altitude]))
        body.set_root_linear_velocity(np.zeros(3))
        body.set_root_angular_velocity(np.zeros(3))
        self.agent.controller.reset()

    # -- the primitive -------------------------------------------------------------------------------------------------

    def run_primitive(self, point: np.ndarray) -> tuple[dict[str, float], dict[str, float]]:
        """Flies to above ``point`` ``[3]`` (m), descends until contact, and lets the aircraft come to rest with its
        motors off.
        """
        link = self.agent.robot.links[0]._objs[0]
        target, speed, steps = np.array([point[0], point[1], self.altitude]), CRUISE_SPEED, 0
        self._touch = None
        while steps < self.control_steps and self._touch is None:
            offset, drift = np.linalg.norm(link.entity_pose.p[:2] - point[:2]), np.linalg.norm(link.linear_velocity[:2])
            if target[2] == self.altitude and offset < 0.03 and drift < 0.2:
                target[2] = point[2] + SLOW_BELOW / 2
            if target[2] < self.altitude and link.entity_pose.p[2] < point[2] + SLOW_BELOW:
                target[2], speed = point[2] - SLOW_BELOW, TOUCH_SPEED
            self.control_step(np.array([[*target, speed]]))
            steps += 1
        touch = self._touch or Touch(link.entity_pose.p, link.entity_pose.p, False, None)
        if self._touch is not None:
            for _ in range(SETTLE_STEPS):
                self.control_step(np.zeros((1, 4)))
            steps += SETTLE_STEPS
        up = np.clip(link.entity_pose.to_transformation_matrix()[2, 2], -1, 1)
        metrics = {
            "landing_offset_m": float(np.linalg.norm(touch.spot[:2] - point[:2])),
            "tilt_deg": float(np.rad2deg(np.arccos(up))),
            "slid": float(np.linalg.norm(link.entity_pose.p[:2] - touch.aircraft[:2]) > SLID),
            "control_steps": float(steps),
        }
        return self._outcome_of(touch), metrics

    def _after_simulation_step(self) -> None:
        if self._touch is not None:
            return
        hull, foot = (link._objs[0] for link in self.agent.robot.links)
        for contact in self.scene.px.get_contacts():
            touching = [point.position for point in contact.points if point.separation < CONTACT]
            own, other = sorted(contact.bodies, key=lambda body: body not in (hull, foot))
            if touching:
                self._touch = Touch(
                    np.mean(touching, axis=0), hull.entity_pose.p, own == foot, self._entities.get(other.entity)
                )
                self.agent.controller.reset()
                return

    def _outcome_of(self, touch: Touch) -> dict[str, float]:
        if not touch.foot:
            return dict.fromkeys(self.REWARD_COMPONENTS, 0.0)
        if touch.block is None:
            return self._properties(None)
        on_top = abs(touch.spot[2] - touch.block.top_at(touch.spot[None])[0]) < ON_TOP
        return self._properties(touch.block) | ({} if on_top else {"flatness": 0.0})

    @staticmethod
    def _properties(block: Block | None) -> dict[str, float]:
        """Sub-rewards of a block's top; None: of the ground."""
        if block is None:
            return {"flatness": 1.0, "color": 0.0}
        return {"flatness": float(block.flat), "color": float(block.color != "gray")}

    def episode_over(self) -> tuple[bool, bool]:
        """Terminated after the last landing of the episode; before that the agent is taken to its next place."""
        self._landings += 1
        over = self._landings >= self.landings_per_episode
        if not over:
            self._fly_to_new_place()
        return over, False

    # -- what the world knows: evaluation and perception only ----------------------------------------------------------

    def _best(self) -> tuple[float, np.ndarray]:
        weigh = dict(zip(self.REWARD_COMPONENTS, self.weights.tolist(), strict=True))

        def reward(thing: Block | None) -> float:
            return sum(weigh[name] * value for name, value in self._properties(thing).items())

        return best_place(self.blocks, self.workspace_bounds, self._pixel_size, self.altitude, reward)

    def highest_reward(self) -> float:
        """Σ_k w_k r_k of the best cell in view that is not hidden and has room for foot and hull (0.2 and 0.5 m)."""
        return self._best()[0]

    def oracle_point(self) -> np.ndarray:
        """``[3]``, m: of the cells of the highest reward the one with the most room around it."""
        return self._best()[1]

    def exact_values(self, gamma: float) -> np.ndarray | None:
        """``[objects, 2]``: Q*_k of landing on each of :meth:`scene_objects`, its sub-rewards when nothing that counts
        comes after.

        None where another landing of this episode counts: its place is drawn at random.
        """
        if gamma > 0 and self._landings + 1 < self.landings_per_episode:
            return None
        seen = in_view(self.blocks, self.workspace_bounds, self._pixel_size)
        return np.array([list(self._properties(block).values()) for block in seen]).reshape(
            -1, len(self.REWARD_COMPONENTS)
        )

    def scene_objects(self) -> list[SceneObject]:
        """The blocks at least partly in view."""
        return [
            SceneObject(
                block.name,
                block.footprint,
                float(block.vertices[:, 2].max()),
                {"color": block.color, "kind": block.kind, "incline_deg": block.incline},
            )
            for block in in_view(self.blocks, self.workspace_bounds, self._pixel_size)
        ]
