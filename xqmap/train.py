"""``python -m xqmap.train +task=landing``: trains, evaluates, leaves a run directory. With ``-m`` many, see
``conf/sweep``.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

import torch
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from xqmap import doctor
from xqmap.config import arguments, cli, schema
from xqmap.errors import Stopped, UserError
from xqmap.evaluation import sheets, sweeps
from xqmap.evaluation.file import evaluation_file
from xqmap.evaluation.run import evaluate_run
from xqmap.files import write_atomically
from xqmap.runs import checkpoint, locks
from xqmap.runs.run import load_run, stored_settings

Saved = tuple[dict[str, Tensor], dict[str, Any]]


def train(cfg: DictConfig) -> float:
    """Trains as ``cfg`` says (or goes on with ``cfg.resume``), evaluates the policy and writes ``evaluation.json``.

    Returns:
        The share of best choices, for a sweeper that searches.
    """
    saved, sweep = None, False
    if cfg.resume is not None:
        place = Path(cfg.resume)
        directory = place.parent.parent if place.suffix == ".safetensors" else place
        saved = checkpoint.read_training(place)
        cfg = stored_settings(saved[1], place)
        print(f"going on with {directory} from decision {saved[1].get('frames')}")
    else:
        directory, sweep = Path(HydraConfig.get().runtime.output_dir), HydraConfig.get().mode == RunMode.MULTIRUN
        if not sweep and ((directory / checkpoint.POLICY).exists() or checkpoint.trainings(directory)):
            raise UserError(
                f"{directory} already holds a run: choose another hydra.run.dir or go on with "
                + arguments.setting("resume", directory)
            )
    schema.validate(cfg)
    sheets.chosen(cfg.task.name, cfg.sheets)
    doctor.require_rendering()
    if cfg.threads:
        torch.set_num_threads(cfg.threads)
    with locks.alone(directory):
        if sweep:
            print(f"job {HydraConfig.get().job.num}: {directory}")
            saved = sweeps.saved(directory, cfg)
        if not sweep or saved is None or saved[1]["frames"] < cfg.trainer.frames:
            _train(cfg, directory, saved)
        return _evaluate(cfg, directory, again=not sweep)


def _evaluate(cfg: DictConfig, directory: Path, again: bool) -> float:
    """Plays the policy of a run as it was trained and on ``cfg.sheets``; unless ``again``, only what was not played
    yet.
    """
    trained, means = dataclasses.replace(load_run(directory), cfg=cfg), []
    for sheet in [None, *sheets.chosen(cfg.task.name, cfg.sheets)]:
        run = sheets.applied(trained, sheets.load(cfg.task.name, sheet) if sheet else {})
        path = evaluation_file(directory, sheet)
        played = None if again else sweeps.evaluated(path, run)
        if played:
            print(f"{path} is complete: not played again")
        else:
            known = None if again else sweeps.baselines(directory.parent, run)
            played = evaluate_run(run, run.cfg.evaluation, path, sheet, known)
        means.append(float(played["success"]["mean"]))
    return means[0]


def _train(cfg: DictConfig, directory: Path, saved: Saved | None) -> None:
    """Trains to the end, or to a signal or failure, and then says how to go on.

    Raises:
        UserError: if training failed.
        Stopped: if a signal ended it.
    """
    from xqmap.trainers.trainer import Trainer  # after the checks: importing the simulator takes seconds

    start = time.perf_counter()
    trainer = Trainer(cfg, directory, saved)
    if saved is None:
        _write_settings(cfg, directory)

    def further() -> str:
        if not trainer.saved_frames:
            return "nothing was saved yet"
        sweep = HydraConfig.get().mode == RunMode.MULTIRUN
        command = "the same command" if sweep else arguments.command("train", resume=directory)
        return f"go on from decision {trainer.saved_frames} with: {command}"

    try:
        trainer.run()
    except (UserError, OSError) as error:
        raise UserError(f"{cli.told(error)}; {further()}") from error
    except Stopped:
        print(f"stopped at once; {further()}")
        raise
    finally:
        trainer.close()
    seconds = time.perf_counter() - start
    print(
        f"{trainer.frames} decisions and {trainer.updates} updates in {seconds:.0f} s; policy in "
        f"{directory / checkpoint.POLICY}"
    )
    if trainer.stopped_by:
        print(f"stopped; {further()}")
        raise Stopped(trainer.stopped_by)


def _write_settings(cfg: DictConfig, directory: Path) -> None:
    """Leaves what Hydra would have left in ``.hydra``: written once the directory is sure to be this run's own and its
    world stands.
    """
    hydra = HydraConfig.get()
    for name, content in {
        "config": cfg,
        "hydra": OmegaConf.create({"hydra": hydra}),
        "overrides": hydra.overrides.task,
    }.items():
        write_atomically(directory / ".hydra" / f"{name}.yaml", OmegaConf.to_yaml(content).encode())


main = cli.main("config")(train)

if __name__ == "__main__":
    cli.resume_in_place(sys.argv)
    main()
