"""What more than one command does with a run directory."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs.utils import step_mdp

from xqmap import doctor, keys
from xqmap.config import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.evaluation import calibration, play
from xqmap.explanations import Decision
from xqmap.runs import checkpoint
from xqmap.runs.checkpoint import Run, load_run


def evaluate_run(
    run: Path | Run,
    settings: DictConfig,
    out: Path,
    sheet: str | None = None,
    baselines: tuple[str, dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Plays a saved policy, prints the table, writes ``play.json``.

    Args:
        run: the run, or its directory.
        settings: ``seeds``, ``choices``, ``until``, ``baselines``, ``calibration``.
        out: the file to write.
        sheet: the name of what ``run.cfg`` and ``settings`` were changed by; None for a run as it was trained.
        baselines: what they made of the same scenes before, and the file that tells it; None plays them where
            ``settings`` asks for them.

    Returns:
        What was written.
    """
    run = run if isinstance(run, Run) else load_run(run)
    env = build.make_env(run.cfg, first_scene=0)()
    try:
        until = dict(settings.until) if settings.until else None
        unplayed = settings.baselines and baselines is None
        played = play.evaluate(run.policy, env, list(settings.seeds), settings.choices, until, unplayed)
        if baselines:
            played["baselines_from"], played["baselines"] = baselines
        if settings.calibration:
            weights = [run.cfg.task.weights.get(name, 1.0) for name in env.components]
            played["calibration"] = calibration.calibrate(
                run.policy, env, list(settings.seeds), run.cfg.loss.gamma, weights, run.cfg.method.reward_key
            )
    finally:
        env.close()
    result = {
        "task": run.cfg.task.name,
        "method": run.cfg.method.name,
        "training_seed": run.cfg.seed,
        **({"sheet": sheet} if sheet else {}),
        **played,
        "settings": settings_of(run.cfg, settings),
        "decisions": run.decisions,
        "weights_sha256": run.sha256,
        "machine": machine(run, env),
        "versions": checkpoint.versions(),
    }
    checkpoint.write_atomically(out, (json.dumps(result, indent=1) + "\n").encode())
    print(play.table(result))
    if settings.calibration:
        print(calibration.table(played["calibration"]))
    print(f"wrote {out}")
    return result


def machine(run: Run, env: ManiSkillEnv) -> dict[str, Any]:
    """What the same seed gives the same numbers on: threads, device and arithmetic, and what simulates and draws the
    world.
    """
    cfg = run.cfg
    computing = {"threads": torch.get_num_threads(), "processors": os.cpu_count(), "device": build.device(cfg).type}
    return {**computing, "training_precision": "bf16" if build.bf16(cfg) else "fp32", **env.task.backends}


def settings_of(cfg: DictConfig, settings: DictConfig) -> dict[str, Any]:
    """What an evaluation depends on besides the weights: the world's settings and its own, plain values."""
    parts = {"weights": cfg.task.weights, "env": cfg.task.env, "evaluation": settings}
    return {name: OmegaConf.to_container(part, resolve=True) for name, part in parts.items()}


def evaluation_file(directory: Path, sheet: str | None = None) -> Path:
    """Where the evaluation of a run is written: ``play.json``, of a sheet ``evaluation-<sheet>.json``."""
    return directory / (f"evaluation-{sheet}.json" if sheet else "evaluation.json")


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
    try:
        state, done = env.reset(), False
        while not done and (steps is None or len(decisions) < steps):
            scene = see(state[keys.HEIGHTMAP].numpy(), env.grid, env.task)
            decision = Decision.from_policy(
                run.policy,
                state,
                scene,
                task=run.cfg.task.name,
                components=run.cfg.method.components,
                level=level,
                scene_seed=scene_seed,
                step=len(decisions),
                noise=run.noise,
            )
            decisions.append(decision)
            row, column = decision.selected.pixel or (0, 0)
            state[keys.ACTION] = torch.tensor(row * env.grid.shape[1] + column)
            if steps is None or len(decisions) < steps:
                state = env.step(state)
                done, state = bool(state["next", keys.DONE]), step_mdp(state)
    finally:
        env.close()
    return decisions


def default_folder(cfg: DictConfig, name: str) -> Path:
    """Where a command writes that was not told: in the run's figures, or beside the decision file."""
    if cfg.decision is not None:
        return Path(cfg.decision).parent / name
    return checkpoint.home(cfg.run) / "figures" / f"scene{cfg.scene_seed}"
