"""What every training is held to before its first work, however it is begun."""

from __future__ import annotations

from pathlib import Path

import torch
from omegaconf import DictConfig

from xqmap import doctor
from xqmap.config import arguments, build, schema
from xqmap.errors import UserError
from xqmap.evaluation import sheets
from xqmap.runs import checkpoint


def require_new(directory: Path, setting: str) -> None:
    """Keeps a training out of a directory that holds a run.

    Args:
        directory: where a run is to be made.
        setting: what names another directory.

    Raises:
        UserError: if there is a run already.
    """
    if (directory / checkpoint.POLICY).exists() or checkpoint.trainings(directory):
        raise UserError(
            f"{directory} already holds a run: choose another {setting} or go on with "
            + arguments.setting("resume", directory)
        )


def require_ready(cfg: DictConfig) -> None:
    """Checks settings and the machine, and takes the threads that were asked for.

    Raises:
        UserError: if a setting is out of its range, a sheet is not there, or nothing can be drawn here.
    """
    schema.validate(cfg)
    sheets.chosen(cfg.task.name, cfg.sheets)
    doctor.require_rendering(build.world(cfg))
    if cfg.threads:
        torch.set_num_threads(cfg.threads)
