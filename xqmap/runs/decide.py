"""The decisions of a run in a scene, and where what is made of them belongs."""

from __future__ import annotations

from omegaconf import DictConfig
from tensordict import TensorDictBase

from xqmap import doctor, keys
from xqmap.config import build
from xqmap.envs.episode import episode
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.explanations import Decision
from xqmap.explanations.perception import Perception
from xqmap.runs.run import Run


def decide(
    run: Run, scene_seed: int, steps: int | None, perception: DictConfig, level: str = "pixel"
) -> list[Decision]:
    """The policy's successive decisions in one scene.

    Args:
        run: whose policy decides.
        scene_seed: of the scene.
        steps: how many decisions at most; None for the whole episode.
        perception: settings of what names the objects (``conf/explain/perception``).
        level: what A, B, … are the best of: every ``"pixel"`` or every ``"object"``.
    """
    doctor.require_rendering(build.world(run.cfg))
    see = build.perception(perception)
    env = build.make_env(run.cfg, first_scene=scene_seed)()
    decisions: list[Decision] = []

    def choose(state: TensorDictBase) -> int | None:
        decisions.append(decide_on(run, env, state, see, level, len(decisions)))
        return None if len(decisions) == steps else cell(decisions[-1], env)

    try:
        for _ in episode(env, choose):
            pass
    finally:
        env.close()
    return decisions


def decide_on(
    run: Run, env: ManiSkillEnv, state: TensorDictBase, see: Perception, level: str = "pixel", step: int = 0
) -> Decision:
    """The policy's decision on the present state of a world.

    Args:
        run: whose policy decides.
        env: the world, in that state.
        state: what it returned: ``heightmap``, ``action_mask``.
        see: names the objects.
        level: what A, B, … are the best of: every ``"pixel"`` or every ``"object"``.
        step: how many decisions of the episode went before.
    """
    return Decision.from_policy(
        run.policy,
        state,
        see(state[keys.HEIGHTMAP].numpy(), env.grid, env.task),
        task=run.cfg.task.name,
        components=run.cfg.method.components,
        level=level,
        scene_seed=env.scene_seed,
        step=step,
        noise=run.noise,
    )


def cell(decision: Decision, env: ManiSkillEnv) -> int:
    """The action that a decision chose, row · W + column."""
    row, column = decision.selected.pixel or (0, 0)
    return row * env.grid.shape[1] + column
