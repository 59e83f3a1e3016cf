"""A training that can be played and explained: its settings and its policy, loaded without running code of its own."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict, TensorDictBase

from xqmap import doctor, keys
from xqmap.config import build, plugins, schema
from xqmap.envs import pictures
from xqmap.envs.episode import episode
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.perception import Perception
from xqmap.explanations.scene import Scene
from xqmap.models.policy import GreedyPolicy
from xqmap.runs import checkpoint
from xqmap.runs.places import POLICY, home, locate
from xqmap.terminal import say

# Settings of earlier versions, on which nothing of what was learned depends.
_FORMER = {"loss": ("windowed",)}
# Settings that trainings had, in effect, before there was a name for them.
_SINCE: dict[str, dict[str, Any]] = {
    "qnet": {"context": 0, "horizon": 0, "raised_height": 0.0},
    "evaluation": {"controls": True},
}


@dataclass
class Run:
    """A trained agent.

    Attributes:
        directory: where it lies, or where what is made from it belongs.
        cfg: the settings of its training.
        policy: what decides.
        noise: its values' typical error, by component.
        sha256: of its weights.
        decisions: how many it learned from.
    """

    directory: Path
    cfg: DictConfig
    policy: GreedyPolicy
    noise: dict[str, float]
    sha256: str
    decisions: int

    def __repr__(self) -> str:
        parts = ", ".join(map(str, self.cfg.method.components))
        return f"<agent of {self.cfg.task.name}: {self.cfg.method.name} on {parts}, {self.decisions} decisions>"

    def make_env(self, scene: int = 0) -> ManiSkillEnv:
        """The world it was trained in, as a torchrl environment.

        Args:
            scene: seed of the first scene (0 to 9999 are scenes no training shows); each reset takes the next one.

        Raises:
            UserError: if nothing can be drawn here.
        """
        doctor.require_rendering(build.world(self.cfg))
        return build.make_env(self.cfg, first_scene=scene)()

    def decide(
        self,
        state: TensorDictBase,
        env: ManiSkillEnv,
        perception: str | Mapping[str, Any] = "simulator",
        candidates: str = "pixel",
        step: int = 0,
    ) -> Decision:
        """What it chooses in the present state of a world, and every number of it.

        Args:
            state: what ``reset`` or ``play`` of the world returned: ``heightmap``, ``action_mask``.
            env: the world, in that state.
            perception: what names the objects: a file of ``conf/explain/perception``, or its settings.
            candidates: what A, B, … are the best of for one component alone: every ``"pixel"`` or every ``"object"``.
            step: how many decisions of the episode went before.

        Raises:
            UserError: if a perception is not installed, ``candidates`` is neither, or the values are not finite.
        """
        scene = _perception(perception)(state[keys.HEIGHTMAP].numpy(), env.grid, env.task)
        return self._decision(state, scene, level=candidates, scene_seed=env.scene_seed, step=step)

    def decide_images(
        self,
        images: str | Path,
        table: float | None = None,
        perception: str | Mapping[str, Any] | None = None,
        candidates: str = "pixel",
        depth_unit: float | None = None,
        camera_axes: str = "opencv",
    ) -> Decision:
        """What it chooses on pictures of one's own. What a person should know of them is said in a line each.

        Args:
            images: an npz file, or a folder of PNG images with ``cameras.json``.
            table: how high the table lay above the map's floor in training, m; None: as in a scene of its own world.
            perception: what names the objects; None: the task's vision, ``<task>_vision``.
            candidates: as in :meth:`decide`.
            depth_unit: metres per number of the depth images; None: integers are millimetres, others metres.
            camera_axes: ``"opencv"`` or ``"opengl"``.

        Raises:
            UserError: if the pictures cannot be read, or show no level table within their bounds.
        """
        read = pictures.read(images, depth_unit, camera_axes)
        see = _perception(f"{self.cfg.task.name}_vision" if perception is None else perception)
        level = self._table() if table is None else table
        image, mask, grid, said = pictures.seen(read, self.policy.qmaps.stem.pixel_size, level)
        for line in said:
            say(f"careful: {line}", to=sys.stderr)
        state = TensorDict({keys.HEIGHTMAP: image, keys.ACTION_MASK: mask})
        return self._decision(state, see(image.numpy(), grid, None), level=candidates)

    def _decision(self, state: TensorDictBase, scene: Scene, **told: Any) -> Decision:
        names = {"task": self.cfg.task.name, "components": self.cfg.method.components}
        return Decision.from_policy(self.policy, state, scene, **names, noise=self.noise, **told)

    def _table(self) -> float:
        """How high the table, or the ground, lies above the map's floor in its own world, m."""
        env = self.make_env()
        image = env.reset()[keys.HEIGHTMAP]
        env.close()
        return float(image[3][(image != 0).any(0)].median())

    def episode(
        self,
        scene: int = 0,
        steps: int | None = 1,
        perception: str | Mapping[str, Any] = "simulator",
        candidates: str = "pixel",
    ) -> list[Decision]:
        """Its successive decisions in one scene, each carried out before the next.

        Args:
            scene: its seed.
            steps: how many decisions at most; None for the whole episode.
            perception: as in :meth:`decide`.
            candidates: as in :meth:`decide`.
        """
        env = self.make_env(scene)
        made: list[Decision] = []

        def choose(state: TensorDictBase) -> int | None:
            made.append(self.decide(state, env, perception, candidates, len(made)))
            return None if len(made) == steps else env.cell(made[-1])

        try:
            for _ in episode(env, choose):
                pass
        finally:
            env.close()
        return made


def _perception(settings: str | Mapping[str, Any]) -> Perception:
    named = plugins.perception(settings) if isinstance(settings, str) else settings
    return build.perception(OmegaConf.create(dict(named)))


def load_run(place: str | Path) -> Run:
    """The policy of a run directory, or of one policy file. Its settings come from the file's own metadata; nothing in
    it is executed.

    Raises:
        UserError: if there is no readable policy.
    """
    place = locate(place)
    file = place if place.suffix == ".safetensors" else place / POLICY
    tensors, facts = checkpoint.read(file)
    cfg = stored_settings(facts, file)
    misfit = f"{file} does not fit its own settings"
    try:
        decisions = int(facts["frames"])
        pixel_size, noise = (
            float(facts["pixel_size"]),
            {str(name): float(value) for name, value in facts["noise"].items()},
        )
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise UserError(f"{misfit} ({error}): train again") from None
    if not (math.isfinite(pixel_size) and pixel_size > 0 and all(map(math.isfinite, noise.values()))):
        raise UserError(f"{misfit} (pixel size or noise is not a number above 0): train again")
    try:
        # Without memory first: settings of a stranger could ask for more than there is.
        if build.shapes(cfg, pixel_size) != {name: tensor.shape for name, tensor in tensors.items()}:
            raise UserError(f"{misfit} (its tensors are not those of its network): train again")
        network = build.qmaps(cfg, pixel_size)
        network.load_state_dict(tensors)
    except (RuntimeError, ValueError, TypeError, OverflowError) as error:
        raise UserError(f"{misfit} ({str(error).splitlines()[0][:200]}): train again") from None
    return Run(home(place), cfg, GreedyPolicy(network).eval(), noise, facts["sha256"], decisions)


def stored_settings(facts: dict[str, Any], file: Path) -> DictConfig:
    """The training's configuration, as stored beside the tensors of ``file``: typed, in range, plain values only.

    Raises:
        UserError: if it is anything else.
    """
    stored = facts.get("config")
    if not isinstance(stored, dict) or not schema.small(stored) or not _plain(stored):
        raise UserError(f"{file} carries no readable settings: train again")
    for part in {*_FORMER, *_SINCE}:
        if isinstance(stored.get(part), dict):
            kept = {name: value for name, value in stored[part].items() if name not in _FORMER.get(part, ())}
            stored = stored | {part: _SINCE.get(part, {}) | kept}
    try:
        cfg = schema.typed(OmegaConf.create(stored))
        schema.validate(cfg, playing=True)
    except UserError as error:
        raise UserError(f"{file}: {error}") from None
    # Its world is the installed one of that name, wherever that was when this was trained.
    named = cfg.task.env.get("_target_") if isinstance(cfg.task.env, DictConfig) else None
    known = plugins.worlds().get(cfg.task.name)
    if known and isinstance(named, str) and named.rpartition(".")[2] == known.rpartition(".")[2]:
        cfg.task.env["_target_"] = known
    return cfg


def _plain(value: Any) -> bool:
    """Whether settings hold no ``${...}``, which could read this machine's environment."""
    if isinstance(value, dict):
        return all(_plain(name) and _plain(entry) for name, entry in value.items())
    if isinstance(value, list):
        return all(map(_plain, value))
    return not (isinstance(value, str) and "${" in value)
