"""The runs under a directory: settings, curves, pictures and how each of them ended, from wandb's files and our own
beside them.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from xqmap.errors import UserError
from xqmap.evaluation import results
from xqmap.evaluation.results import Result
from xqmap.files import read_bytes
from xqmap.reports import offline
from xqmap.reports.offline import Logged
from xqmap.runs import locks

# Bytes of a metrics.csv: some five hundred a row.
_LARGEST_FILE = 100_000_000


@dataclass
class Run:
    """One training, finished or not.

    Attributes:
        name: its directory, relative to where the report looks.
        directory: the run directory.
        settings: by dotted name.
        columns: metrics by name, ``[T]`` each, in the order of ``frames``; NaN where a row has none.
        pictures: Q-Map picture files by decisions made.
        environment: host, os, python and the like.
        result: its ``evaluation.json``, if it got so far.
        overrides: what its command line said, ``key=value`` each; empty where it was not kept.
        ended: False where wandb's file stops without saying that the run did.
        running: whether a process on this machine still writes to it.
        trouble: what could not be read.
    """

    name: str
    directory: Path
    settings: dict[str, Any] = field(default_factory=dict)
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    pictures: dict[int, Path] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    result: Result | None = None
    overrides: list[str] = field(default_factory=list)
    ended: bool = True
    running: bool = False
    trouble: str = ""

    @property
    def task(self) -> str:
        """Name of the task."""
        return self.result.task if self.result else str(self.settings["task.name"])

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.result.method if self.result else str(self.settings["method.name"])

    @property
    def seed(self) -> Any:
        """Of the training."""
        return self.result.content["training_seed"] if self.result else self.settings.get("seed")

    @property
    def decisions(self) -> int:
        """Made in training, as far as they were logged."""
        return int(self.last("frames"))

    @property
    def minutes(self) -> float:
        """Of wall-clock in training."""
        return self.last("seconds") / 60

    @property
    def finished(self) -> bool:
        """Whether it trained to its end and was evaluated."""
        return self.state == "finished"

    @property
    def state(self) -> str:
        """How it ended, in words; ``finished`` where all is well."""
        wanted = self.settings.get("trainer.frames")
        short = isinstance(wanted, int) and self.decisions < wanted
        if self.result and not short:
            return "finished"
        progress = (
            f"at {self.decisions:,} of {wanted:,} decisions"
            if isinstance(wanted, int)
            else f"at {self.decisions:,} decisions"
        )
        if self.running:
            return f"running, {progress}"
        if not self.ended:
            return f"broke off {progress}"
        return f"stopped {progress}" if short else "not evaluated"

    def last(self, name: str) -> float:
        """The last known value of a metric; 0 if there is none."""
        values = self.columns.get(name, np.array([]))
        known = values[np.isfinite(values)]
        return float(known[-1]) if len(known) else 0.0


def gather(root: Path, found: Sequence[Result]) -> tuple[list[Run], dict[Path, str]]:
    """Every run under ``root``, and what there is that is none.

    Args:
        root: where to look.
        found: the evaluations under ``root`` (:func:`xqmap.evaluation.results.collect`).

    Returns:
        The runs in the order of their names, and ``{path: why}`` of what was left out.
    """
    files: dict[Path, list[Path]] = {}
    for path in sorted(root.rglob("*.wandb")):
        files.setdefault(_run_directory(path), []).append(path)
    evaluated = {result.directory: result for result in found if not result.sheet}
    settled = {path.parent.parent for path in root.rglob(".hydra/config.yaml")}
    directories = sorted({*files, *evaluated, *settled, *(path.parent for path in root.rglob("metrics.csv"))})
    runs: list[Run] = []
    foreign: dict[Path, str] = {}
    for directory in tqdm(directories, unit="run", desc="reading", mininterval=1.0, disable=not directories):
        logs = [offline.read(path) for path in files.get(directory, [])]
        run = _run(root, directory, logs, evaluated.get(directory))
        if run.result or {"task.name", "method.name"} <= set(run.settings):
            runs.append(run)
        elif "report" not in run.settings:  # an earlier report, logged among the runs
            foreign[directory] = run.trouble or "no run of xqmap: its settings name no task and method"
    return runs, foreign


def _run_directory(path: Path) -> Path:
    """``RUN/wandb/offline-run-…/run-….wandb`` belongs to RUN; a wandb folder that was moved elsewhere stands for
    itself.
    """
    holder = path.parent.parent
    return holder.parent if holder.name == "wandb" else path.parent


def _run(root: Path, directory: Path, logs: list[Logged], result: Result | None) -> Run:
    run = Run(str(directory.relative_to(root)) if directory != root else directory.name, directory, result=result)
    for logged in logs:
        # A resumed run's later part replaces what came after the checkpoint.
        run.columns = _joined(run.columns, logged.columns)
        begun = logged.columns.get("frames", np.array([0.0]))[:1]
        run.pictures = {
            step: p for step, p in run.pictures.items() if not len(begun) or step < begun[0]
        } | logged.pictures
        run.environment |= logged.environment
        run.settings = results.flat({name: value for name, value in logged.config.items() if not name.startswith("_")})
    run.ended = not logs or logs[-1].exit_code is not None
    stored = result.settings if result else results.settings_of(directory)
    # wandb has the values that the stored settings only point to.
    run.settings = {
        name: run.settings.get(name, value) if "${" in str(value) else value for name, value in stored.items()
    } or run.settings
    run.trouble = "; ".join(f"{logged.path.name}: {logged.trouble}" for logged in logs if logged.trouble)
    # wandb writes in larger pieces than we do: a file that breaks off, or cannot be read to its end, lacks the last
    # rows.
    beside = _metrics(directory / "metrics.csv")
    if len(beside.get("frames", ())) > len(run.columns.get("frames", ())):
        run.columns = beside
    if not run.pictures:
        run.pictures = {
            int(p.stem[5:]): p for p in sorted(directory.glob("figures/qmaps*.png")) if p.stem[5:].isdecimal()
        }
    overrides = results.stored(directory, "overrides")
    run.overrides = [str(entry) for entry in overrides] if isinstance(overrides, list) else []
    run.running = not run.finished and locks.held(directory)
    return run


def _joined(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Two parts of one run as one: ``seconds`` go on where the first part's kept rows end."""
    if "frames" not in before or "frames" not in after or not len(after["frames"]):
        return after if "frames" in after else before
    kept = before["frames"] < after["frames"][0]
    if kept.any() and {"seconds"} <= set(before) & set(after):
        after = after | {"seconds": after["seconds"] + before["seconds"][kept][-1]}
    empty = np.full(kept.sum(), np.nan), np.full(len(after["frames"]), np.nan)
    return {
        name: np.concatenate([before[name][kept] if name in before else empty[0], after.get(name, empty[1])])
        for name in {**before, **after}
    }


def _metrics(path: Path) -> dict[str, np.ndarray]:
    """``metrics.csv`` by column; nothing where it is missing or not ours."""
    try:
        head, *rows = csv.reader(io.StringIO(read_bytes(path, _LARGEST_FILE, inside=path.parent).decode(), newline=""))
        if len(head) * len(rows) > offline.MOST_NUMBERS:
            return {}
        # A row that a crash cut off lacks its last numbers.
        numbers = [[float(text or "nan") for text in row] + [math.nan] * (len(head) - len(row)) for row in rows]
        columns = dict(zip(head, np.array(numbers).reshape(len(rows), len(head)).T, strict=True))
    except (UserError, ValueError, csv.Error):
        return {}
    if "seconds" in columns:
        # They begin anew where a run was resumed.
        seconds = columns["seconds"]
        columns["seconds"] = seconds + np.cumsum([0.0, *np.where(seconds[1:] < seconds[:-1], seconds[:-1], 0.0)])
    return columns if "frames" in columns else {}
