"""``python -m xqmap.train +task=landing``: trains, evaluates, leaves a run directory."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from xqmap import checkpoint, cli, commands, doctor, schema
from xqmap.errors import Stopped, UserError


def train(cfg: DictConfig) -> None:
    """Trains as ``cfg`` says (or goes on with ``cfg.resume``), evaluates the policy and writes ``evaluation.json``."""
    saved = None
    if cfg.resume is not None:
        place = Path(cfg.resume)
        directory = place.parent.parent if place.suffix == ".safetensors" else place
        saved = checkpoint.read_training(place)
        cfg = checkpoint.settings(saved[1], place)
        print(f"going on with {directory} from decision {saved[1].get('frames')}")
    else:
        directory = Path(HydraConfig.get().runtime.output_dir)
        if (directory / checkpoint.POLICY).exists() or checkpoint.trainings(directory):
            raise UserError(f"{directory} already holds a run: choose another hydra.run.dir or go on with resume={directory}")
    schema.validate(cfg)
    doctor.require_rendering()
    if cfg.threads:
        torch.set_num_threads(cfg.threads)
    if saved is None:
        _write_settings(cfg, directory)
    _train(cfg, directory, saved)
    commands.evaluate_run(directory, cfg.evaluation, directory / "evaluation.json")


def _train(cfg: DictConfig, directory: Path, saved: tuple[dict[str, Tensor], dict[str, Any]] | None) -> None:
    """Trains to the end, or to a signal or failure, and then says how to go on.

    Raises:
        UserError: if training failed.
        Stopped: if a signal ended it.
    """
    from xqmap.trainer import Trainer  # after the checks: importing the simulator takes seconds

    start = time.perf_counter()
    trainer = Trainer(cfg, directory, saved)

    def further() -> str:
        if not trainer.saved_frames:
            return "nothing was saved yet"
        return f"go on from decision {trainer.saved_frames} with: python -m xqmap.train resume={directory}"

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
    print(f"{trainer.frames} decisions and {trainer.updates} updates in {seconds:.0f} s; policy in {directory / checkpoint.POLICY}")
    if trainer.stopped_by:
        print(f"stopped; {further()}")
        raise Stopped(trainer.stopped_by)


def _write_settings(cfg: DictConfig, directory: Path) -> None:
    """Leaves what Hydra would have left in ``.hydra``: written here, once it is sure that the directory is this run's own."""
    hydra = HydraConfig.get()
    for name, content in {"config": cfg, "hydra": OmegaConf.create({"hydra": hydra}), "overrides": hydra.overrides.task}.items():
        checkpoint.write_atomically(directory / ".hydra" / f"{name}.yaml", OmegaConf.to_yaml(content).encode())


main = cli.main("config")(train)

if __name__ == "__main__":
    cli.resume_in_place(sys.argv)
    main()
