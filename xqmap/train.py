"""``python -m xqmap.train +task=landing``: trains, evaluates, leaves a run directory."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from xqmap import checkpoint, cli, commands, doctor, schema
from xqmap.errors import UserError


def train(cfg: DictConfig) -> None:
    """Trains as ``cfg`` says (or goes on with ``cfg.resume``), evaluates the policy and writes ``evaluation.json``."""
    resume = cfg.resume is not None
    if resume:
        directory = Path(cfg.resume)
        _, facts = checkpoint.read(directory / checkpoint.TRAINING)
        cfg = schema.typed(checkpoint.settings(facts, directory))
        print(f"going on with {directory}")
    else:
        directory = Path(HydraConfig.get().runtime.output_dir)
        if (directory / checkpoint.POLICY).exists():
            raise UserError(f"{directory} already holds a run: choose another hydra.run.dir or go on with resume={directory}")
    schema.validate(cfg)
    doctor.require_rendering()
    if cfg.threads:
        torch.set_num_threads(cfg.threads)

    from xqmap.trainer import Trainer  # after the checks: importing the simulator takes seconds

    start = time.perf_counter()
    trainer = Trainer(cfg, directory, resume=resume)
    try:
        trainer.run()
        seconds = time.perf_counter() - start
        print(f"{trainer.frames} decisions and {trainer.updates} updates in {seconds:.0f} s; policy in {directory / checkpoint.POLICY}")
        if trainer.stopped_by:
            print(f"stopped; go on with: python -m xqmap.train resume={directory}")
            sys.exit(128 + trainer.stopped_by)
    finally:
        trainer.close()
    commands.evaluate_run(directory, cfg.evaluation, directory / "evaluation.json")


main = cli.main("config")(train)

if __name__ == "__main__":
    cli.resume_in_place(sys.argv)
    main()
