"""``python -m xqmap.train +task=landing``: trains, evaluates, leaves a run directory. With ``-m`` many, see
``conf/sweep``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from xqmap.config import arguments, cli
from xqmap.evaluation import sweeps
from xqmap.runs import begin, checkpoint, locks
from xqmap.runs.run import Run, stored_settings
from xqmap.terminal import say


def train(cfg: DictConfig) -> float:
    """Trains as ``cfg`` says (or goes on with ``cfg.resume``), evaluates the policy and writes ``evaluation.json``.

    Returns:
        The share of best choices, for a sweeper that searches.
    """
    place, sweep = None if cfg.resume is None else Path(cfg.resume), False
    if place is None:
        directory, sweep = Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().mode == RunMode.MULTIRUN
    else:
        directory = place.parent.parent if place.suffix == ".safetensors" else place
    # Held before anything is read: what another process is about to write is not gone on from.
    with locks.alone(directory):
        saved = None
        if place is not None:
            saved = checkpoint.read_training(place)
            cfg = stored_settings(saved[1], place)
            say(f"going on with {directory} from decision {saved[1].get('frames')}")
        elif not sweep:
            begin.require_new(directory, "hydra.run.dir")
        begin.require_ready(cfg)
        if sweep:
            say(f"job {HydraConfig.get().job.num}: {directory}")
            saved = sweeps.saved(directory, cfg)
        if not sweep or saved is None or saved[1]["frames"] < cfg.trainer.frames:
            from xqmap.trainers import training  # after the checks: importing the simulator takes seconds

            further = "the same command" if sweep else arguments.command("train", resume=directory)
            training.train(cfg, directory, saved, _left_by_hydra(cfg), further)
        return sweeps.evaluate(cfg, directory, again=not sweep)


def _left_by_hydra(cfg: DictConfig) -> dict[str, Any]:
    """What Hydra would have written to ``.hydra``, by name."""
    hydra = HydraConfig.get()
    return {"config": cfg, "hydra": OmegaConf.create({"hydra": hydra}), "overrides": hydra.overrides.task}


class _Callable(ModuleType):
    """Python calls a module that was imported by its package's name for it: ``xqmap.train(...)`` means the function."""

    def __call__(self, *changes: Any, **named: Any) -> Run:
        from xqmap import api  # which a command does not need

        return api.train(*changes, **named)


sys.modules[__name__].__class__ = _Callable
main = cli.main("config")(train)

if __name__ == "__main__":
    cli.resume_in_place(sys.argv)
    main()
