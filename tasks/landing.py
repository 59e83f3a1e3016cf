"""Landing: a flying agent picks a spot of a field of blocks and touches down there.

Task Description:
    From a constant altitude the agent sees part of a field of blocks, straight down. It picks a cell of the heightmap; the primitive
    flies to above the 3-D point behind it and descends under control until the physics reports contact.

Randomizations (all from the reset's seed):
    Number, place, footprint, height and yaw of the blocks; their tops flat or inclined; green, red, blue or gray, each a little lighter
    or darker; direction and strength of the light; where over the field the agent is.

Episode:
    ``landings_per_episode`` decisions, each from a new place at the same altitude over the same field. A landing takes at most
    ``control_steps`` control steps; a time-out pays nothing.

Reward components (at the touched spot, the mean of the first contact's points):
    ``flatness``: 1 if θ = arccos(n·q) ≤ 5° between the vertical n and the true surface normal q there (a wall has θ = 90°).
    ``color``: 1 unless what was touched is gray (the ground is).

Cells:
    The camera looks from above, so the ground right behind a block stays hidden. Such cells are empty in the heightmap (0 high, black)
    and cannot be chosen: no 3-D point is known there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import sapien_utils
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.types import SceneConfig, SimConfig

from tasks.agents.aircraft import Aircraft
from tasks.base import DecisionEnv, SceneObject
from tasks.blocks import COLORS, Block, mesh, sample_field

FLAT_DEG = 5.0
# The camera's axis x looks along the body's −z; given as a unit quaternion because look_at does not return one straight down.
DOWN = sapien.Pose([0, 0, -0.02], [0.70710678, 0, 0.70710678, 0])
HALF_SIZE = 20.0
CELLS = 84
FRICTION = 0.8
CRUISE_SPEED = 10.0
# Heights (m) over the point: from here on the descent is slow, and a contact is looked for at each simulation step.
SLOW_BELOW = 1.0
TOUCH_SPEED = 0.8
SETTLE_STEPS = 4
# How far the touched spot may lie off a face's plane and still be on it (m): PhysX reports contacts a little early.
ON_FACE = 0.05
# A cell this far inside a block's edges has the whole landing pad over the block (m).
PAD_MARGIN = 0.2


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
        light: how far the light may vary, 0 (never) to 1.
        landings_per_episode: decisions before the field changes.
        control_steps: the most a landing may take.
        kwargs: of :class:`DecisionEnv`.
    """

    REWARD_COMPONENTS = ("flatness", "color")
    BACKGROUND = "ground"
    METRICS = ("landing_offset_m", "tilt_deg", "slid", "control_steps")
    SUPPORTED_ROBOTS = ["xqmap_aircraft"]  # noqa: RUF012 (ManiSkill's own declaration)
    agent: Aircraft

    def __init__(
        self,
        *,
        altitude: float,
        pixel_size: float,
        image_size: int,
        blocks: tuple[int, int],
        incline_deg: tuple[float, float],
        inclined_share: float,
        light: float,
        landings_per_episode: int,
        control_steps: int,
        **kwargs: Any,
    ) -> None:
        self.altitude, self._pixel_size, self.image_size = altitude, pixel_size, image_size
        self.block_range, self.incline_deg, self.inclined_share = tuple(blocks), tuple(incline_deg), inclined_share
        self.light_variation, self.landings_per_episode, self.control_steps = light, landings_per_episode, control_steps
        self.blocks: list[Block] = []
        self._entities: list[tuple[sapien.Entity, Block]] = []
        self._location = np.zeros(2)
        self._landings = 0
        self._touch: tuple[np.ndarray, Block | None] | None = None
        self._watching = False
        super().__init__(robot_uids="xqmap_aircraft", **kwargs)

    # -- the world -----------------------------------------------------------------------------------------------------

    @property
    def workspace_bounds(self) -> np.ndarray:
        """``[3, 2]``, m: the part of the field in view, from just below the ground to 6 m."""
        half = CELLS * self._pixel_size / 2
        x, y = self._location
        return np.array([[x - half, x + half], [y - half, y + half], [-0.05, 6.0]])

    @property
    def pixel_size(self) -> float:
        """Edge of a heightmap cell, m."""
        return self._pixel_size

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(sim_freq=100, control_freq=5, scene_config=SceneConfig(bounce_threshold=5.0))

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        # Wide enough for the rim of the map at the height of the tallest top.
        half = CELLS * self._pixel_size / 2
        fov = 2 * float(np.arctan(half / (self.altitude - 4.0)))
        size = self.image_size
        return [
            CameraConfig("down", DOWN, size, size, fov, 0.1, 32.0, mount=self.agent.robot.links[0], shader_pack="minimal")
        ]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        pose = sapien_utils.look_at([11.0, -13.0, 10.0], [0.0, 0.0, 0.5])
        return CameraConfig("view", pose, 960, 640, 0.9, 0.1, 100.0, shader_pack="default")

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, sapien.Pose([0, 0, self.altitude]))

    def _load_lighting(self, options: dict[str, Any]) -> None:
        self._sun = self.scene.sub_scenes[0].add_directional_light([0, 0, -1], [1, 1, 1])

    def _load_scene(self, options: dict[str, Any]) -> None:
        self._entities = []
        ground = self.scene.create_actor_builder()
        gray = sapien.render.RenderMaterial(base_color=(*(np.array(COLORS["gray"]) / 255 * 0.8), 1.0))
        half = [3 * HALF_SIZE, 3 * HALF_SIZE, 0.5]
        ground.add_box_collision(sapien.Pose([0, 0, -0.5]), half)
        ground.add_box_visual(sapien.Pose([0, 0, -0.5]), half, material=gray)
        ground.initial_pose = sapien.Pose()
        ground.build_static("ground")

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        # A generator of its own: what the blocks and places are depends on the reset's seed and on nothing drawn before.
        self._rng = np.random.RandomState(int(self._episode_seed[0]))
        count = self._rng.randint(self.block_range[0], self.block_range[1] + 1)
        drawn = sample_field(self._rng, HALF_SIZE, count, self.incline_deg, self.inclined_share, gap=0.6)
        given = options.get("blocks")
        self.blocks = drawn if given is None else [Block(**block) for block in given]
        self._build_blocks()
        tilt = self.light_variation * self._rng.uniform(-0.5, 0.5, 2)
        self._sun.entity.set_pose(sapien.Pose([0, 0, 0], sapien.math.shortest_rotation([1, 0, 0], [*tilt, -1])))
        strength = 1.6 * (1 + self.light_variation * self._rng.uniform(-0.25, 0.25))
        self._sun.color = [strength] * 3
        ambient = 0.45 * (1 + self.light_variation * self._rng.uniform(-0.25, 0.25))
        self.scene.sub_scenes[0].set_ambient_light([ambient] * 3)
        self._landings = 0
        self._fly_to_new_place()

    def _build_blocks(self) -> None:
        scene = self.scene.sub_scenes[0]
        for entity, _ in self._entities:
            scene.remove_entity(entity)
        self._entities = []
        surface = sapien.physx.PhysxMaterial(FRICTION, FRICTION, 0.0)
        for block in self.blocks:
            vertices, triangles, normals = mesh(block)
            color = np.clip(np.array(COLORS[block.color]) / 255 * block.shade, 0, 1)
            material = sapien.render.RenderMaterial(base_color=(*color, 1.0))
            drawn = sapien.render.RenderBodyComponent()
            uvs = np.zeros((len(vertices), 2), dtype=np.float32)
            drawn.attach(sapien.render.RenderShapeTriangleMesh(vertices, triangles, normals, uvs, material))
            body = sapien.physx.PhysxRigidStaticComponent()
            body.attach(sapien.physx.PhysxCollisionShapeConvexMesh(block.vertices.astype(np.float32), np.ones(3, np.float32), surface))
            entity = sapien.Entity()
            entity.set_name(block.name)
            entity.add_component(drawn)
            entity.add_component(body)
            scene.add_entity(entity)
            self._entities.append((entity, block))

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
        """Flies to above ``point`` ``[3]`` (m), descends until contact, lets the aircraft settle with its motors off."""
        link = self.agent.robot.links[0]._objs[0]
        above = np.array([point[0], point[1], self.altitude])
        self._touch, self._watching = None, False
        steps = 0
        while steps < self.control_steps and self._touch is None:
            offset = np.linalg.norm(link.pose.p[:2] - point[:2])
            speed = np.linalg.norm(link.linear_velocity[:2])
            if above[2] == self.altitude and offset < 0.03 and speed < 0.2:
                above[2] = point[2] + SLOW_BELOW / 2
            if above[2] < self.altitude and link.pose.p[2] < point[2] + SLOW_BELOW:
                self._watching = True
                above[2] = point[2] - SLOW_BELOW
            self.control_step(np.array([[*above, TOUCH_SPEED if self._watching else CRUISE_SPEED]]))
            steps += 1
        self._watching = False
        at_touch = link.pose.p.copy()
        if self._touch is not None:
            for _ in range(SETTLE_STEPS):
                self.control_step(np.zeros((1, 4)))
        up = link.pose.to_transformation_matrix()[2, 2]
        metrics = {
            "landing_offset_m": float(np.linalg.norm(at_touch[:2] - point[:2])),
            "tilt_deg": float(np.rad2deg(np.arccos(np.clip(up, -1, 1)))),
            "slid": float(np.linalg.norm(link.pose.p[:2] - at_touch[:2]) > self._pixel_size),
            "control_steps": float(steps),
        }
        return self._rewards(self._touch), metrics

    def _after_simulation_step(self) -> None:
        if not self._watching or self._touch is not None:
            return
        own = [link._objs[0] for link in self.agent.robot.links]
        for contact in self.scene.px.get_contacts():
            others = [body for body in contact.bodies if body not in own]
            touching = [p.position for p in contact.points if p.separation < 0.005]
            if len(others) == 1 and touching:
                block = next((block for entity, block in self._entities if entity == others[0].entity), None)
                self._touch = np.mean(touching, axis=0), block
                self.agent.controller.reset()
                return

    def _rewards(self, touch: tuple[np.ndarray, Block | None] | None) -> dict[str, float]:
        if touch is None:
            return dict.fromkeys(self.REWARD_COMPONENTS, 0.0)
        spot, block = touch
        if block is None:
            return {"flatness": 1.0, "color": 0.0}
        on_top = abs(spot[2] - float(block.top_at(spot[None, :2])[0])) < ON_FACE
        return self._properties(block, on_top)

    @staticmethod
    def _properties(block: Block, on_top: bool) -> dict[str, float]:
        theta = block.incline if on_top else 90.0
        return {"flatness": float(theta <= FLAT_DEG), "color": float(block.color != "gray")}

    def episode_over(self) -> tuple[bool, bool]:
        """After the last landing of the episode; else the agent is at its next place."""
        self._landings += 1
        over = self._landings >= self.landings_per_episode
        if not over:
            self._fly_to_new_place()
        return over, False

    # -- what the world knows: evaluation and perception only ----------------------------------------------------------

    def _landable(self, block: Block) -> np.ndarray:
        """``[M, 3]``: cells' points on the block's top with the whole pad over it, in view and not hidden by another block."""
        (x0, _), (y0, _), _ = self.workspace_bounds
        centres = (np.arange(CELLS) + 0.5) * self._pixel_size
        cells = np.stack(np.meshgrid(x0 + centres, y0 + centres), axis=-1).reshape(-1, 2)
        cells = cells[block.covers(cells, PAD_MARGIN)]
        points = np.column_stack((cells, block.top_at(cells)))
        # From the middle outwards, a few are enough to know whether and where.
        points = points[np.argsort(np.linalg.norm(block.local(cells), axis=1))][:12]
        if not len(points):
            return points
        eye = np.array([*self._location, self.altitude])
        rays = points[:, None] + np.linspace(0.01, 0.25, 60)[:, None] * (eye - points)[:, None]
        flat = rays.reshape(-1, 3)
        hidden = np.zeros(len(flat), dtype=bool)
        for other in self.blocks:
            if other is not block:
                hidden |= other.covers(flat) & (flat[:, 2] < other.top_at(flat))
        return points[~hidden.reshape(len(points), -1).any(1)]

    def _choices(self) -> list[tuple[float, np.ndarray]]:
        """Reward and point of each block that can be landed on, and of a spot of open ground."""
        weight = dict(zip(self.REWARD_COMPONENTS, self.weights.tolist(), strict=True))
        found = []
        for block in self.blocks:
            points = self._landable(block)
            if len(points):
                properties = self._properties(block, on_top=True)
                found.append((sum(weight[name] * value for name, value in properties.items()), points[0]))
        rng = np.random.RandomState(0)
        for _ in range(200):
            spot = self._location + rng.uniform(-0.4, 0.4, 2) * CELLS * self._pixel_size
            if all(np.hypot(*(spot - (b.x, b.y))) > b.radius + 1.5 for b in self.blocks):
                found.append((weight["flatness"], np.array([*spot, 0.0])))
                break
        return found

    def highest_reward(self) -> float:
        """The highest reward of any place that is in view, not hidden, and wide enough for the pad."""
        return max((reward for reward, _ in self._choices()), default=0.0)

    def oracle_point(self) -> np.ndarray:
        """``[3]``, m: the middle-most such place of the highest reward."""
        return max(self._choices(), key=lambda choice: choice[0])[1]

    def scene_objects(self) -> list[SceneObject]:
        """The blocks at least partly in view."""
        (x0, x1), (y0, y1), _ = self.workspace_bounds
        inside = [b for b in self.blocks if x0 < b.x + b.radius and b.x - b.radius < x1 and y0 < b.y + b.radius and b.y - b.radius < y1]
        return [
            SceneObject(
                block.name,
                block.footprint,
                float(block.vertices[:, 2].max()),
                {"color": block.color, "kind": "inclined block" if block.incline > 0 else "flat block", "incline_deg": block.incline},
            )
            for block in inside
        ]
