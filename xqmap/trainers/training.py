"""A training of a run directory, from its first file to what is said at its end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from xqmap.config import cli
from xqmap.errors import Stopped, UserError
from xqmap.files import write_atomically
from xqmap.runs import checkpoint
from xqmap.terminal import say
from xqmap.trainers.callbacks import make_trainer
from xqmap.trainers.trainer import Saved, Trainer


def train(cfg: DictConfig, directory: Path, saved: Saved | None, settings: Mapping[str, Any], command: str) -> Trainer:
    """Trains to the end, or to a signal or failure, and then says how to go on.

    Args:
        cfg: validated settings.
        directory: the run directory, which this process holds.
        saved: of the checkpoint to go on from; None begins.
        settings: what a new run leaves as ``.hydra/NAME.yaml``, once its world stands.
        command: what goes on with this run.

    Returns:
        The trainer, closed.

    Raises:
        UserError: if training failed.
        Stopped: if a signal ended it.
    """
    start = time.perf_counter()
    trainer = make_trainer(cfg, directory, saved)
    if saved is None:
        for name, content in settings.items():
            write_atomically(directory / ".hydra" / f"{name}.yaml", OmegaConf.to_yaml(content).encode())

    def further() -> str:
        if not trainer.saved_frames:
            return "nothing was saved yet"
        return f"go on from decision {trainer.saved_frames} with: {command}"

    try:
        trainer.run()
    except (UserError, OSError) as error:
        raise UserError(f"{cli.told(error)}; {further()}") from error
    except Stopped:
        say(f"stopped at once; {further()}")
        raise
    finally:
        trainer.close()
    seconds = time.perf_counter() - start
    say(
        f"{trainer.frames} decisions and {trainer.updates} updates in {seconds:.0f} s; policy in "
        f"{directory / checkpoint.POLICY}"
    )
    if trainer.stopped_by:
        say(f"stopped; {further()}")
        raise Stopped(trainer.stopped_by)
    return trainer
