"""Many trainings from one command: what of it is already done, and the table at its end."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from xqmap.config import build, plugins
from xqmap.errors import UserError
from xqmap.evaluation import results, sheets, tables
from xqmap.evaluation.file import evaluation_file, read
from xqmap.evaluation.run import evaluate_run, settings_of
from xqmap.evaluation.swept import differing, flat, shown
from xqmap.files import write_atomically
from xqmap.runs import checkpoint
from xqmap.runs.places import PRETRAINED
from xqmap.runs.run import Run, load_run, stored_settings
from xqmap.terminal import one_line, say

# Settings that no trained weight depends on.
_BESIDE = ("evaluation", "sheets", "device", "threads", "resume", "logger")


class Table(Callback):
    """After a sweep (Hydra's ``-m``) one table over its runs: printed, and beside them as ``table.txt``, ``table.md``
    and ``table.csv``.
    """

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Reads every evaluation in the sweep's directory."""
        directory = Path(config.hydra.sweep.dir)
        found, unread = results.collect(directory)
        rows = results.table(found, results.paper_figures())
        written = {
            "table.txt": tables.text(rows) + "\n",
            "table.md": tables.markdown(rows),
            "table.csv": tables.comma_separated(rows),
        }
        for name, content in written.items():
            write_atomically(directory / name, content.encode())
        say(tables.text(rows))
        for path, why in unread.items():
            say(one_line(f"not in the table: {path} ({why})"))
        say(f"wrote {', '.join(written)} to {directory}")


def saved(directory: Path, cfg: DictConfig) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
    """What this training goes on from in ``directory``; None where it has not got to its first checkpoint.

    Raises:
        UserError: if what is there was trained with other settings.
    """
    if not checkpoint.trainings(directory):
        return None
    found = checkpoint.read_training(directory)
    before, now = (flat(OmegaConf.to_container(c, resolve=True)) for c in (stored_settings(found[1], directory), cfg))
    names = [name for name in differing([before, now]) if name.split(".")[0] not in _BESIDE]
    if names:
        was, told = (shown(settings.get(names[0])) for settings in (before, now))
        raise UserError(
            f"{directory} holds a run with {names[0]}={was}, not {told}: choose another hydra.sweep.dir, or take it "
            "away"
        )
    return found


def evaluate(cfg: DictConfig, directory: Path, again: bool) -> float:
    """Plays the policy of a run as it was trained and on ``cfg.sheets``; unless ``again``, only what was not played
    yet.

    Returns:
        The share of best choices as it was trained.
    """
    trained, means = dataclasses.replace(load_run(directory), cfg=cfg), []
    for sheet in [None, *sheets.chosen(cfg.task.name, cfg.sheets)]:
        run = sheets.applied(trained, sheets.load(cfg.task.name, sheet) if sheet else {})
        path = evaluation_file(directory, sheet)
        played = None if again else evaluated(path, run)
        if played:
            say(f"{path} is complete: not played again")
        else:
            known = baselines(directory.parent, run)
            played = evaluate_run(run, run.cfg.evaluation, path, sheet, known)
        means.append(float(played["success"]["mean"]))
    return means[0]


def evaluated(path: Path, run: Run) -> dict[str, Any] | None:
    """The evaluation in ``path``, if it is complete and of these weights under these settings."""
    content = _of_these_scenes(path, run)
    return content if content and content["weights_sha256"] == run.sha256 else None


def baselines(folder: Path, run: Run) -> tuple[str, dict[str, Any]] | None:
    """What another run in ``folder``, or an agent that ships, found for the baselines in the same scenes of the same
    world, and in which file; None where none has played them.

    No policy changes them: played once, they stand in every run's evaluation.
    """
    shipped = sorted(PRETRAINED.glob("*/evaluation*.json"))
    world = plugins.source_sha256(build.world(run.cfg))
    for path in [*sorted(folder.glob("*/evaluation*.json")), *shipped]:
        content = _of_these_scenes(path, run)
        same = content and content["versions"] == checkpoint.versions() and content.get("world_sha256") == world
        if content and same and content["baselines"]:
            name = path.relative_to(PRETRAINED.parent if path in shipped else folder)
            return content.get("baselines_from", str(name)), content["baselines"]
    return None


def _of_these_scenes(path: Path, run: Run) -> dict[str, Any] | None:
    try:
        content = read(path)
        content["settings"]["env"].pop("_target_", None)
        same = content["task"] == run.cfg.task.name and content["settings"] == settings_of(run.cfg, run.cfg.evaluation)
        return content if same and {"weights_sha256", "baselines", "versions"} <= content.keys() else None
    except (UserError, KeyError, TypeError, AttributeError):
        return None
