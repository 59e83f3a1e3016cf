"""An evaluation of a run: played, printed, written."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from xqmap.config import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.evaluation import calibration, play
from xqmap.files import write_atomically
from xqmap.runs import checkpoint
from xqmap.runs.run import Run, load_run


def evaluate_run(
    run: Path | Run,
    settings: DictConfig,
    out: Path,
    sheet: str | None = None,
    baselines: tuple[str, dict[str, Any]] | None = None,
) -> dict[str, Any]:
    """Plays a saved policy, prints the table, writes ``evaluation.json``.

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
    write_atomically(out, (json.dumps(result, indent=1) + "\n").encode())
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
    # Which class a task's world is, the installed package says.
    env = {name: value for name, value in cfg.task.env.items() if name != "_target_"}
    parts = {"weights": cfg.task.weights, "env": OmegaConf.create(env), "evaluation": settings}
    return {name: OmegaConf.to_container(part, resolve=True) for name, part in parts.items()}
