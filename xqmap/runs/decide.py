"""The decisions of a run in a scene, and where what is made of them belongs."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig
from tensordict import TensorDictBase

from xqmap import doctor, keys
from xqmap.config import build
from xqmap.envs.episode import episode
from xqmap.explanations import Decision
from xqmap.runs.run import Run, home


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
    doctor.require_rendering()
    see = build.perception(perception)
    env = build.make_env(run.cfg, first_scene=scene_seed)()
    decisions: list[Decision] = []

    def choose(state: TensorDictBase) -> int | None:
        decision = Decision.from_policy(
            run.policy,
            state,
            see(state[keys.HEIGHTMAP].numpy(), env.grid, env.task),
            task=run.cfg.task.name,
            components=run.cfg.method.components,
            level=level,
            scene_seed=scene_seed,
            step=len(decisions),
            noise=run.noise,
        )
        decisions.append(decision)
        row, column = decision.selected.pixel or (0, 0)
        return None if len(decisions) == steps else row * env.grid.shape[1] + column

    try:
        for _ in episode(env, choose):
            pass
    finally:
        env.close()
    return decisions


def default_folder(cfg: DictConfig, name: str) -> Path:
    """Where a command writes that was not told: in the run's figures, or beside the decision file."""
    if cfg.decision is not None:
        return Path(cfg.decision).parent / name
    return home(cfg.run) / "figures" / f"scene{cfg.scene_seed}"
