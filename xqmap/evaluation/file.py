"""The file of an evaluation: its place, and what one that may be a stranger's has to hold to be counted with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

# Of numbers in an evaluation.
_LARGEST = 1e12


def evaluation_file(directory: Path, sheet: str | None = None) -> Path:
    """Where the evaluation of a run is written: ``evaluation.json``, of a sheet ``evaluation-<sheet>.json``."""
    return directory / (f"evaluation-{sheet}.json" if sheet else "evaluation.json")


def wrong(content: Any) -> str:
    """Why this is not an evaluation that can be counted; empty if it is one."""
    needed = {"task": str, "method": str, "training_seed": int, "runs": list}
    if not isinstance(content, dict) or any(not isinstance(content.get(name), kind) for name, kind in needed.items()):
        return f"no evaluation of xqmap: {', '.join(needed)} are needed"
    for run in content["runs"]:
        counts = {name: run.get(name) for name in ("choices", "correct", "regret")} if isinstance(run, dict) else None
        if (
            not _numbers(counts, 1)
            or not _numbers(run.get("components", {}), 1)
            or not 0 <= run["correct"] <= run["choices"]
        ):
            return "a run in it lacks choices, correct or regret"
    if not any(run["choices"] for run in content["runs"]):
        return "no choice was made in it"
    baselines = content.get("baselines") or {}
    for row in baselines.values() if isinstance(baselines, dict) else [baselines]:
        rate = {name: row.get(name) for name in ("mean", "std", "choices")} if isinstance(row, dict) else None
        limits = row.get("ci95") if isinstance(row, dict) else None
        if (
            not _numbers(rate, 1)
            or not isinstance(limits, list)
            or len(limits) != 2
            or not _numbers(dict(enumerate(limits)), 1)
        ):
            return "a baseline in it lacks mean, std, choices or ci95"
        if not is_number(row.get("regret", 0.0)):
            return "a baseline's regret in it is no number"
    confusion = content.get("confusion") or {}
    if not _numbers(confusion, 2):
        return "its confusion holds no counts"
    names = [
        content["task"],
        content["method"],
        *baselines,
        *confusion,
        *(name for run in content["runs"] for name in run.get("components", {})),
    ]
    # Control characters could move a terminal's cursor; half a character cannot be written at all.
    if not all(name.isprintable() for name in (*names, *(best for bests in confusion.values() for best in bests))):
        return "a name in it cannot be printed"
    return ""


def is_number(value: Any) -> bool:
    """Whether this is a number that can be reckoned with: NaN is, infinity and what no count or reward comes near are
    not.
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and not abs(value) > _LARGEST


def _numbers(tree: Any, depth: int) -> bool:
    """Whether this is a dictionary of numbers, so many levels deep."""
    if depth == 0:
        return is_number(tree)
    return isinstance(tree, dict) and all(_numbers(inner, depth - 1) for inner in tree.values())
