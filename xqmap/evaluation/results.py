"""Every ``evaluation.json`` under a directory, and the rows of a paper's table that they make together."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from xqmap.config import plain, plugins
from xqmap.errors import UserError
from xqmap.evaluation import file, statistics
from xqmap.evaluation.swept import flat, grouped, label, swept


@dataclass
class Result:
    """One evaluated training.

    Attributes:
        directory: the run directory.
        sheet: which of its evaluations: empty for ``evaluation.json``, ``"hard"`` for ``evaluation-hard.json``.
        content: what the file holds.
        settings: the run's settings by dotted name; empty where it kept none.
    """

    directory: Path
    sheet: str
    content: dict[str, Any]
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def task(self) -> str:
        """Name of the task."""
        return str(self.content["task"])

    @property
    def method(self) -> str:
        """Name of the method."""
        return str(self.content["method"])


@dataclass
class Row:
    """One line of the table: a method (over all its trainings) or a baseline, on one sheet of one task.

    Attributes:
        task: its name.
        sheet: which evaluation; empty for the usual one.
        name: of the method or baseline.
        settings: the swept settings that tell this row from its neighbours.
        training_seeds: of the trainings it sums up; empty for a baseline.
        mean: of the runs' success rates.
        std: their standard deviation.
        choices: of all runs together.
        ci95: the interval of the rate.
        interval: how ``ci95`` was made: ``Wilson``, or ``bootstrap`` over training seeds.
        regret: mean of highest reward available − reward taken.
        components: mean sub-reward by component; empty for a baseline.
        confusion: choices by object chosen, then object best; empty where it was not recorded.
        paper: what the paper prints for it; empty where it has no such row.
    """

    task: str
    sheet: str
    name: str
    settings: dict[str, Any]
    training_seeds: list[int]
    mean: float
    std: float
    choices: int
    ci95: tuple[float, float]
    interval: str
    regret: float
    components: dict[str, float] = field(default_factory=dict)
    confusion: dict[str, dict[str, int]] = field(default_factory=dict)
    paper: str = ""

    @property
    def label(self) -> str:
        """The name with the swept settings behind it."""
        return label(self.name, self.settings)


def paper_figures() -> dict[str, dict[str, str]]:
    """What the paper prints, ``{task: {method: text}}`` (``conf/report/paper.yaml``)."""
    found = [folder / "report" / "paper.yaml" for folder in plugins.folders()]
    return {task: texts for path in reversed(found) if path.is_file() for task, texts in plain.read(path).items()}


def collect(root: str | Path) -> tuple[list[Result], dict[Path, str]]:
    """Reads every ``evaluation.json`` (and ``evaluation-SHEET.json``) under ``root``.

    Returns:
        The results, in the order of their paths, and what could not be read: ``{path: why}``. One policy on one sheet
        counts once, however often its directory was copied.

    Raises:
        UserError: if there is no such directory.
    """
    if not Path(root).is_dir():
        raise UserError(f"there is no directory {root}: give runs=DIR, one that runs were written to")
    found: dict[tuple[str, ...], Result] = {}
    unread: dict[Path, str] = {}
    for path in sorted(Path(root).rglob("evaluation*.json")):
        try:
            content = file.read(path)
        except UserError as error:
            unread[path] = str(error).removeprefix(f"{path}: ")
            continue
        result = Result(
            path.parent, path.stem.removeprefix("evaluation").strip("-_"), content, settings_of(path.parent)
        )
        found.setdefault((result.task, result.method, result.sheet, str(content.get("weights_sha256", path))), result)
    return list(found.values()), unread


def settings_of(run: Path) -> dict[str, Any]:
    """A run's settings as Hydra stored them, by dotted name; empty where there are none that can be read."""
    found = stored(run, "config")
    return flat(found) if isinstance(found, dict) else {}


def stored(run: Path, name: str) -> Any:
    """What Hydra left in a run's ``.hydra/NAME.yaml``, as plain values; None where that cannot be read."""
    try:
        # Unresolved: what a file leaves to a resolver is the same text in every run.
        return plain.read(run / ".hydra" / f"{name}.yaml", inside=run)
    except UserError:
        return None


def table(results: Sequence[Result], paper: Any = None, names: dict[str, list[str]] | None = None) -> list[Row]:
    """One row per task × sheet × method × swept settings, each task's baselines below its methods.

    Args:
        results: from :func:`collect`.
        paper: the paper's figures, ``{task: {name: text}}``.
        names: the swept settings by task, where more is known of them than these results tell; None finds them
            (:func:`~xqmap.evaluation.swept.swept`).
    """
    names, paper = names or swept(results), paper or {}
    rows: list[Row] = []
    for (task, sheet), members in sorted(grouped(results, lambda r: (r.task, r.sheet)).items()):
        known = paper.get(task, {}) if not sheet else {}
        order = list(dict.fromkeys([*paper.get(task, {}), *(result.method for result in members)]))
        members.sort(key=lambda r: (order.index(r.method), *(_rank(r.settings.get(name)) for name in names[r.task])))
        groups = grouped(members, lambda r: (r.method, *(repr(r.settings.get(name)) for name in names[r.task])))
        rows += [
            _policy(group, _at(group[0], names[task]), str(known.get(group[0].method, ""))) for group in groups.values()
        ]
        rows += _baselines(members, names[task], known)
    return rows


def _policy(group: Sequence[Result], settings: dict[str, Any], paper: str) -> Row:
    first = group[0]
    runs = [run for result in group for run in result.content["runs"]]
    over_runs = statistics.success(runs)
    low, high = over_runs["ci95"]
    if len(group) > 1:
        # A handful of flawless trainings would bootstrap to no width at all: never narrower than Wilson's.
        outer = statistics.bootstrap([statistics.success(result.content["runs"])["mean"] for result in group])
        low, high = min(low, outer[0]), max(high, outer[1])
    choices = max(1, over_runs["choices"])
    confusion: dict[str, dict[str, int]] = {}
    for result in group:
        for chosen, bests in (result.content.get("confusion") or {}).items():
            for best, count in bests.items():
                confusion.setdefault(chosen, {})[best] = confusion.get(chosen, {}).get(best, 0) + count
    return Row(
        task=first.task,
        sheet=first.sheet,
        name=first.method,
        settings=settings,
        training_seeds=[result.content["training_seed"] for result in group],
        mean=over_runs["mean"],
        std=over_runs["std"],
        choices=over_runs["choices"],
        ci95=(low, high),
        interval="bootstrap" if len(group) > 1 else "Wilson",
        regret=sum(run["regret"] * run["choices"] for run in runs) / choices,
        components={
            name: sum(run["components"].get(name, 0.0) * run["choices"] for run in runs) / choices
            for name in dict.fromkeys(name for run in runs for name in run.get("components", {}))
        },
        confusion=confusion,
        paper=paper,
    )


def _baselines(members: Sequence[Result], names: list[str], paper: Any) -> list[Row]:
    """A baseline plays the same scenes whatever was trained, so equal entries are one row; sweeping the world makes
    several.
    """
    rows: dict[str, Row] = {}
    for name in dict.fromkeys(name for result in members for name in result.content.get("baselines") or {}):
        having = [result for result in members if name in (result.content.get("baselines") or {})]
        versions = grouped(having, lambda r: json.dumps(r.content["baselines"][name], sort_keys=True))  # noqa: B023 (used at once)
        for group in versions.values():
            entry = group[0].content["baselines"][name]
            # What the runs with this entry have in common tells it from its other versions.
            common = (
                [n for n in names if len({repr(r.settings.get(n)) for r in group}) == 1] if len(versions) > 1 else []
            )
            row = Row(
                task=group[0].task,
                sheet=group[0].sheet,
                name=name,
                settings=_at(group[0], common),
                training_seeds=[],
                mean=entry["mean"],
                std=entry["std"],
                choices=entry["choices"],
                ci95=(entry["ci95"][0], entry["ci95"][1]),
                interval="Wilson",
                regret=entry.get("regret", float("nan")),
                paper=str(paper.get(name, "")),
            )
            if row.label not in rows or rows[row.label].choices < row.choices:
                rows[row.label] = row
    return list(rows.values())


def _rank(value: Any) -> tuple[bool, float, str]:
    """Numbers by size, then everything else by its text."""
    number = isinstance(value, int | float)
    return not number, value if number else 0.0, repr(value)


def _at(result: Result, names: Iterable[str]) -> dict[str, Any]:
    return {name: result.settings.get(name) for name in names}
