"""The rows of :mod:`xqmap.evaluation.results` as text, Markdown and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from xqmap.evaluation.results import Row
from xqmap.evaluation.swept import shown

COLUMNS = (
    "task",
    "sheet",
    "method",
    "best choices",
    "± over runs",
    "95 % interval",
    "choices",
    "trainings",
    "regret",
    "paper",
)


def percent(share: float, decimals: int = 1) -> str:
    """A share as people read it: ``99.3 %``."""
    return f"{100 * share:.{decimals}f} %"


def interval(low: float, high: float) -> str:
    """Two shares and the sign once: ``97.6 – 99.8 %``."""
    return f"{100 * low:.1f} – {percent(high)}"


def cells(row: Row) -> list[str]:
    """A row as people read it, one text per entry of :data:`COLUMNS`."""
    trainings = str(len(row.training_seeds)) if row.training_seeds else ""
    rate = [percent(row.mean), percent(row.std), interval(*row.ci95)]
    return [row.task, row.sheet, row.label, *rate, str(row.choices), trainings, f"{row.regret:.3f}", row.paper]


def lines(rows: Sequence[Row]) -> list[list[str]]:
    """The head and every row, without the columns that no row fills."""
    every = [cells(row) for row in rows]
    kept = [i for i in range(len(COLUMNS)) if any(line[i] for line in every)]
    return [[line[i] for i in kept] for line in (list(COLUMNS), *every)]


def words(head: Sequence[str]) -> int:
    """How many columns on the left hold words, not numbers."""
    return list(head).index("method") + 1


def text(rows: Sequence[Row]) -> str:
    """The table for a terminal."""
    head, *every = lines(rows)
    widths, left = [max(map(len, column)) for column in zip(head, *every, strict=True)], words(head)
    aligned = [
        [line[i].ljust(w) if i < left else line[i].rjust(w) for i, w in enumerate(widths)] for line in (head, *every)
    ]
    return "\n".join("  ".join(line).rstrip() for line in aligned)


def markdown(rows: Sequence[Row]) -> str:
    """The table for a README or a paper's draft."""
    head, *every = lines(rows)
    rule = ["---" if i < words(head) else "---:" for i in range(len(head))]
    escaped = [[cell.replace("|", "\\|") for cell in line] for line in every]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, rule, *escaped)) + "\n"


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
