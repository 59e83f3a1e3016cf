"""The rows of :mod:`xqmap.results` as text, Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from xqmap.results import Row, shown

COLUMNS = ("task", "method", "best choices", "± over runs", "95 % interval", "choices", "trainings", "regret", "paper")


def cells(row: Row) -> list[str]:
    """A row as people read it, one text per entry of :data:`COLUMNS`."""
    low, high = row.ci95
    trainings = str(len(row.training_seeds)) if row.training_seeds else ""
    task = f"{row.task} ({row.sheet})" if row.sheet else row.task
    rate = [f"{row.mean:.1%}", f"{row.std:.1%}", f"{low:.1%} – {high:.1%}"]
    return [task, row.label, *rate, str(row.choices), trainings, f"{row.regret:.3f}", row.paper]


def text(rows: Sequence[Row]) -> str:
    """The table for a terminal."""
    lines = [list(COLUMNS), *map(cells, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    aligned = [[c.ljust(w) if i < 2 else c.rjust(w) for i, (c, w) in enumerate(zip(line, widths, strict=True))] for line in lines]
    return "\n".join("  ".join(line).rstrip() for line in aligned)


def markdown(rows: Sequence[Row]) -> str:
    """The table for a README or a paper's draft."""
    lines = [list(COLUMNS), ["---", "---", *["---:"] * (len(COLUMNS) - 2)], *([c.replace("|", "\\|") for c in cells(row)] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def comma_separated(rows: Sequence[Row]) -> str:
    """The table for a program: rates between 0 and 1, one column per swept setting."""
    names = list(dict.fromkeys(name for row in rows for name in row.settings))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["task", "sheet", "method", *names, "mean", "std", "ci95_low", "ci95_high", "interval", "choices"]
    head += ["training_seeds", "regret", "paper"]
    writer.writerow(head)
    for row in rows:
        setting = [shown(row.settings[name]) if name in row.settings else "" for name in names]
        seeds = " ".join(map(str, row.training_seeds))
        rate = [row.mean, row.std, *row.ci95, row.interval, row.choices]
        writer.writerow([row.task, row.sheet, row.name, *setting, *rate, seeds, row.regret, row.paper])
    return out.getvalue()
