"""What can be checked: every run and how it ended, settings that differ, machines, versions, and what was chosen for
what.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from xqmap.evaluation import results, tables
from xqmap.evaluation.file import is_number
from xqmap.evaluation.results import Row
from xqmap.evaluation.swept import differing, grouped, shown
from xqmap.explanations.views import markup
from xqmap.reports.runs import Run


def runs(every: Sequence[Run]) -> str:
    """One line per training."""
    head = (
        "run",
        "task",
        "method",
        "state",
        "started",
        "machine",
        "seed",
        "decisions",
        "updates",
        "minutes",
        "best choices",
    )
    lines = []
    for run in every:
        rate = tables.percent(results.table([run.result])[0].mean) if run.result else ""
        began = str(run.environment.get("started_at", ""))[:16].replace("T", " ")
        numbers = [f"{run.decisions:,}", f"{int(run.last('updates')):,}", f"{run.minutes:.1f}", rate]
        lines.append(
            [
                run.name,
                run.task,
                run.method,
                run.state,
                began,
                str(run.environment.get("host", "")),
                str(run.seed),
                *numbers,
            ]
        )
    # A file that is being written has no end yet: no trouble.
    troubled = [
        f"<li>{escape(run.name)}: {escape(run.trouble)}</li>" for run in every if run.trouble and not run.running
    ]
    notes = (
        f"<p class=soft>What wandb's reader says against their files:</p><ul class=soft>{''.join(troubled)}</ul>"
        if troubled
        else ""
    )
    return markup.table(head, lines, "Every training, finished or not.", text_columns=6) + notes


def components(rows: Sequence[Row]) -> str:
    """How well each property was met."""
    names = list(dict.fromkeys(name for row in rows for name in row.components))
    lines = [
        [row.label, *(f"{row.components[name]:.3f}" for name in names)]
        for row in rows
        if row.components and not row.sheet
    ]
    return markup.table(("method", *names), lines, "Mean sub-reward of the choices, by component.") if lines else ""


def settings(every: Sequence[Run]) -> str:
    """What differs between a task's trainings besides the seed: one line per setting and value."""
    names = [name for name in differing(run.settings for run in every) if name != "seed"]
    if not names:
        return "<h3>Settings that differ</h3><p>None but the seed.</p>"
    lines = []
    for name in names:
        having: dict[str, list[str]] = {}
        for run in every:
            having.setdefault(shown(run.settings[name]) if name in run.settings else "–", []).append(run.name)
        lines += [[name, value, ", ".join(runs), str(len(runs))] for value, runs in having.items()]
    caption = "Settings that are not the same in all trainings of this task, besides the seed."
    return (
        f"<h3>Settings that "
        f"differ</h3>{markup.table(('setting', 'value', 'runs', 'trainings'), lines, caption, text_columns=3)}"
    )


def machines(every: Sequence[Run]) -> str:
    """Where the trainings ran, and with which versions."""
    facts = {"machine": "host", "system": "os", "Python": "python"}
    places = grouped(every, lambda run: tuple(str(run.environment.get(name, "unknown")) for name in facts.values()))
    lines = [[*place, str(len(members))] for place, members in places.items()]
    parts = [markup.table((*facts, "trainings"), lines, "Machines", text_columns=3)]
    commands = grouped((run for run in every if run.overrides or "program" in run.environment), _command)
    lines = [[command, str(len(members))] for command, members in commands.items()]
    parts += [markup.table(("command", "trainings"), lines, "What trains them again")] if lines else []
    versions: dict[tuple[str, str], int] = {}
    for run in every:
        known = run.result.content.get("versions") if run.result else None
        known = known if isinstance(known, dict) else {}
        git = run.environment.get("git")
        commit = git.get("commit") if isinstance(git, dict) else None
        for name, value in (known | ({"git commit": str(commit)[:10]} if commit else {})).items():
            versions[name, str(value)] = versions.get((name, str(value)), 0) + 1
    lines = [[name, value, str(count)] for (name, value), count in sorted(versions.items())]
    if lines:
        parts.append(
            markup.table(
                ("what", "version", "trainings"),
                lines,
                "Versions; one that is listed twice differs between trainings.",
                2,
            )
        )
    return "".join(parts)


def _command(run: Run) -> str:
    """What trains this again: of a sweep its one job, whichever launcher ran it."""
    if run.overrides:
        return shlex.join(["python", "-m", "xqmap.train", *run.overrides])
    given = run.environment.get("args") or []
    return shlex.join(
        ["python", *str(run.environment["program"]).split(), *map(str, given if isinstance(given, list) else [])]
    )


def calibration(every: Sequence[Run]) -> str:
    """The Q-Maps against exact values and against the returns that followed, where an evaluation compared them."""
    lines = []
    for run in every:
        compared = run.result.content.get("calibration") if run.result else None
        for against, title in {"exact": "exact value", "returns": "return that followed"}.items():
            known = compared.get(against) if isinstance(compared, dict) else None
            for name, row in known.items() if isinstance(known, dict) else []:
                lines.append(
                    [
                        run.name,
                        name,
                        title,
                        *(_figure(row, key) for key in ("bias", "mae", "rank_correlation", "sign_accuracy")),
                    ]
                )
    head = ("run", "Q-Map", "against", "bias", "absolute error", "rank correlation", "signs of differences right")
    return (
        f"<h3>Values that can be checked</h3>{markup.table(head, lines, 'The Q-Maps against what is known.', 3)}"
        if lines
        else ""
    )


def _figure(row: Any, name: str) -> str:
    value = row.get(name) if isinstance(row, dict) else None
    return f"{value:.3f}" if is_number(value) else ""


def left_out(paths: dict[Path, str]) -> str:
    """What lies among the runs and is not in the report."""
    return markup.table(
        ("path", "why"), [[str(path), why] for path, why in paths.items()], "Not counted", text_columns=2
    )


def confusion(row: Row) -> str:
    """Which object was chosen where which was best."""
    bests = sorted({best for counts in row.confusion.values() for best in counts})
    lines = [
        [chosen, *(str(row.confusion[chosen].get(best, 0) or "·") for best in bests)]
        for chosen in sorted(row.confusion)
    ]
    title = f"{row.label}, {row.sheet}" if row.sheet else row.label
    caption = "Choices by the object chosen (rows) and the object that was best (columns)."
    return f"<h3>Chosen and best: {escape(title)}</h3>{markup.table(('chosen', *bests), lines, caption)}"
