"""What more than one command does with a run directory."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from xqmap import build, checkpoint, evaluation
from xqmap.checkpoint import Run, load_run


def evaluate_run(run: Path | Run, settings: DictConfig, out: Path) -> dict[str, Any]:
    """Plays a saved policy, prints the table, writes ``evaluation.json``.

    Args:
        run: the run, or its directory.
        settings: ``seeds``, ``choices``, ``until``, ``baselines``.
        out: the file to write.

    Returns:
        What was written.
    """
    run = run if isinstance(run, Run) else load_run(run)
    env = build.make_env(run.cfg, first_scene=0)()
    try:
        until = dict(settings.until) if settings.until else None
        played = evaluation.evaluate(run.policy, env, list(settings.seeds), settings.choices, until, settings.baselines)
    finally:
        env.close()
    result = {
        "task": run.cfg.task.name,
        "method": run.cfg.method.name,
        "training_seed": run.cfg.seed,
        **played,
        "weights_sha256": run.sha256,
        "versions": checkpoint.versions(),
    }
    checkpoint.write_atomically(out, (json.dumps(result, indent=1) + "\n").encode())
    print(evaluation.table(result))
    print(f"wrote {out}")
    return result
