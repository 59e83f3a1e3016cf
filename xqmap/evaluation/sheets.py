"""Evaluation sheets: other scenes, or more of them, to play a trained policy on. Files of ``conf/sheet/<task>``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from xqmap.config import plugins, schema
from xqmap.errors import UserError

if TYPE_CHECKING:
    from xqmap.runs.run import Run

ALL = "all"


def names(task: str) -> list[str]:
    """The sheets there are for a task."""
    return plugins.stems("sheet", task)


def chosen(task: str, wanted: Sequence[str]) -> list[str]:
    """What ``sheets=[...]`` asks for; ``all`` stands for every sheet of the task.

    Raises:
        UserError: naming a sheet that the task does not have.
    """
    known = names(task)
    if unknown := [name for name in wanted if name not in (*known, ALL)]:
        raise UserError(f"sheets names {unknown[0]!r}; {task} has {', '.join(known) or 'none'} (conf/sheet/{task})")
    return known if ALL in wanted else list(wanted)


def load(task: str, name: str) -> DictConfig:
    """What a sheet changes: ``task.env`` and ``evaluation`` settings."""
    path = plugins.find("sheet", task, f"{name}.yaml")
    assert path is not None, (task, name)
    sheet = OmegaConf.load(path)
    assert isinstance(sheet, DictConfig)
    return sheet


def applied(run: Run, changes: Any) -> Run:
    """The same policy with other settings of its world (``task.env``) and of its evaluation.

    Raises:
        UserError: if a setting is not one of that world, or would change which code runs.
    """
    changes = OmegaConf.create(changes)
    known = set(run.cfg.task.env)
    for name in OmegaConf.select(changes, "task.env") or {}:
        if name not in known or str(name).startswith("_"):
            settings = sorted(str(key) for key in known if not str(key).startswith("_"))
            raise UserError(f"task.env has no setting {name!r} to change; there are {', '.join(settings)}")
    cfg = schema.typed(OmegaConf.merge(run.cfg, changes))
    schema.validate(cfg, playing=True)
    return dataclasses.replace(run, cfg=cfg)
