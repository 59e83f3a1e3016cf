"""An evaluation of a run: played, printed, written."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from xqmap.config import build, plugins, schema
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.evaluation import calibration, play
from xqmap.evaluation.file import read
from xqmap.evaluation.swept import differing, flat, shown
from xqmap.files import write_atomically
from xqmap.runs import checkpoint
from xqmap.runs.run import Run, load_run
from xqmap.terminal import say


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
        seeds, gamma = list(settings.seeds), run.cfg.loss.gamma
        weights = schema.weights_in_order(run.cfg.task.weights, env.components)
        rules = settings.choices, until, unplayed, gamma, weights, settings.controls
        played = play.evaluate(run.policy, env, seeds, *rules)
        if baselines:
            played["baselines_from"], played["baselines"] = baselines
        if settings.calibration:
            played["calibration"] = calibration.calibrate(
                run.policy, env, seeds, gamma, weights, run.cfg.method.reward_key
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
        "world_sha256": plugins.source_sha256(build.world(run.cfg)),
        "versions": checkpoint.versions(),
    }
    write_atomically(out, (json.dumps(result, indent=1) + "\n").encode())
    say(play.table(result))
    if settings.calibration:
        say(calibration.table(played["calibration"]))
    say(f"wrote {out}")
    return result


def require_own(file: Path, cfg: DictConfig, world: DictConfig) -> None:
    """Keeps an evaluation under changed settings out of the file that tells of the run as it was trained.

    Args:
        file: where the evaluation would be written.
        cfg: the run's settings with all changes.
        world: what was changed of ``task``.

    Raises:
        UserError: naming the setting that is another one.
    """
    if changes := [name for name in flat(OmegaConf.to_container(world)) if OmegaConf.select(world, name) != {}]:
        raise UserError(
            f"task.{changes[0]} is changed: give out=FILE, so that no file of this run tells of another world"
        )
    try:
        before = flat(read(file)["settings"])
    except (UserError, KeyError):
        return
    now = flat(settings_of(cfg, cfg.evaluation))
    # A setting that one of them lacks is newer than the file.
    if names := [name for name in differing([before, now]) if name in before and name in now]:
        was, told = (shown(settings[names[0]]) for settings in (before, now))
        raise UserError(f"{file} tells of {names[0]}={was}, not {told}: give out=FILE, so that it stays")


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
