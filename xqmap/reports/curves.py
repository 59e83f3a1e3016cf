"""Learning curves: a line per method over its trainings, a band from the lowest training to the highest."""

from __future__ import annotations

import itertools
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from xqmap.evaluation import results, tables
from xqmap.evaluation.results import Row
from xqmap.explanations.views.style import PALETTE, drawing
from xqmap.reports.runs import Run

# Places along a curve; more than a screen's width would show.
POINTS = 200
# Each is the mean over so many places about it: a row of metrics holds a few decisions and is mostly noise. ``success``
# looks back itself.
SMOOTHED = POINTS // 20 + 1
# What the groups of metrics mean, in the order they are shown.
METRICS = {
    "success": "Best choices among the last 100 decisions, exploration included",
    "return": "Return of an episode, by component",
    "q_bias": "Q less the return that came, by Q-Map: above zero it promised too much",
    "td_error": "Mean absolute TD error, by Q-Map",
    "loss": "TD loss, by Q-Map",
}
# What a curve is drawn against: a column, its unit in the column's own, and what stands below the axis.
AXES = {"frames": (1, "decisions"), "seconds": (60, "minutes")}
# Methods begin where components end, so that no color means both in the two-component tasks.
COLORS = (*PALETTE[2:6], PALETTE[7], *PALETTE[:2])
# Where two methods learned the same, the one below shows in the gaps.
STROKES = ("-", (0, (4, 2)), (0, (1, 1.5)))
WIDTH = 10.6
_SMALL = {"font.size": 9, "axes.titlesize": 9.5}


@dataclass
class Curve:
    """One metric of one method: ``x``, and over its trainings ``mean``, ``low`` and ``high``, ``[POINTS]`` each."""

    x: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray


def curve(runs: Sequence[Run], metric: str, against: str, span: float = 0.0) -> Curve | None:
    """A metric over the trainings of one method; None where none of them has it.

    Args:
        runs: the trainings.
        metric: its column.
        against: ``frames`` or ``seconds``; the unit of ``x`` is that of ``AXES``.
        span: the end of the axis it shares with other methods, so that all are smoothed alike; at least its own.
    """
    parts, ends = [], []
    for run in runs:
        x, y = (run.columns.get(name, np.array([])) for name in (against, metric))
        if len(x) == len(y) and len(known := np.flatnonzero(np.isfinite(x) & np.isfinite(y))):
            parts.append(_thinned(x[known] / AXES[against][0], y[known]))
            ends += [parts[-1][0][-1]] if run.finished else []
    if not parts:
        return None
    # Where the first finished training ends the curve does: a mean over fewer would jump. A broken one counts as far as
    # it came.
    end = min(ends) if ends else max(x[-1] for x, _ in parts)
    grid = np.linspace(min(max(x[0] for x, _ in parts), end), max(span, end), POINTS)
    values = np.array(
        [_smooth(np.interp(grid, x, y, right=np.nan), 1 if metric == "success" else SMOOTHED) for x, y in parts]
    )
    known = np.isfinite(values).any(0) & (grid <= end)
    values = values[:, known]
    return Curve(grid[known], np.nanmean(values, 0), np.nanmin(values, 0), np.nanmax(values, 0))


def _smooth(values: np.ndarray, places: int) -> np.ndarray:
    """Means over so many places, fewer at the ends; what is not known stays so and counts for nothing."""
    known, window = np.isfinite(values), np.ones(places)
    sums, counts = (np.convolve(row, window, "same") for row in (np.where(known, values, 0.0), known.astype(float)))
    return np.where(known, sums / np.maximum(counts, 1), np.nan)


def _thinned(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most POINTS places, each the mean of the rows about it."""
    if len(x) <= POINTS:
        return x, y
    groups = np.linspace(0, len(x), POINTS + 1).astype(int)[:-1]
    counts = np.diff([*groups, len(x)])
    return np.add.reduceat(x, groups) / counts, np.add.reduceat(y, groups) / counts


def columns(runs: Sequence[Run], metric: str) -> list[str]:
    """The columns of a group of metrics: ``return`` has ``return/color`` and the like, in the order of the settings'
    components.
    """
    order = [
        f"{metric}/{name}"
        for key in ("task.components", "method.components")
        for run in runs
        for name in _listed(run.settings.get(key))
    ]
    there = dict.fromkeys(
        name for run in runs for name in run.columns if name == metric or name.startswith(f"{metric}/")
    )
    return list(dict.fromkeys([name for name in order if name in there] + list(there)))


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def learning(groups: dict[str, list[Run]], metric: str, colors: dict[str, str]) -> Figure | None:
    """A group of metrics, one panel per component, against interactions and against minutes; None where nothing was
    logged.

    Args:
        groups: trainings by the label of their method.
        metric: a key of ``METRICS``.
        colors: by label.
    """
    names = columns([run for runs in groups.values() for run in runs], metric)
    names = [name for name in names if any(curve(runs, name, "frames") for runs in groups.values())]
    if not names:
        return None
    # One panel has its two axes side by side; several have them one below the other.
    shape = (1, 2) if len(names) == 1 else (2, len(names))
    with drawing(_SMALL):
        figure = Figure(figsize=(WIDTH, 0.3 + 2.2 * shape[0]), layout="constrained")
        axes = figure.subplots(*shape, squeeze=False)
        styles = dict(zip(groups, itertools.cycle(STROKES), strict=False))
        lines = [Line2D([], [], color=colors[label], lw=2, ls=styles[label]) for label in groups]
        names_of_lines = [textwrap.shorten(label, 120, placeholder=" …") for label in groups]
        side_by_side = max(1, 120 // (6 + max(map(len, names_of_lines))))
        figure.legend(lines, names_of_lines, loc="outside upper left", ncols=side_by_side, frameon=False)
        for i, (against, (_, unit)) in enumerate(AXES.items()):
            for j, name in enumerate(names):
                axis: Axes = axes.ravel()[i * len(names) + j]
                span = max(
                    (line.x[-1] for runs in groups.values() if (line := curve(runs, name, against))), default=0.0
                )
                for label, runs in groups.items():
                    if line := curve(runs, name, against, span):
                        axis.fill_between(line.x, line.low, line.high, color=colors[label], alpha=0.2, lw=0)
                        axis.plot(line.x, line.mean, color=colors[label], lw=1.6, ls=styles[label])
                axis.set_title(name.partition("/")[2] if i == 0 else "")
                axis.set_xlabel(unit)
                axis.grid(axis="y", color="0.87", lw=0.6)
                if metric == "success":
                    axis.set_ylim(0, 1.02)
                    axis.yaxis.set_major_formatter(_percent)
        return figure


def _beside(label: str) -> str:
    """A label left of an axis: two lines at most."""
    return textwrap.fill(textwrap.shorten(label, 76, placeholder=" …"), 40)


def _percent(value: float, place: float) -> str:
    return tables.percent(value, 0)


def intervals(rows: Sequence[Row], colors: dict[str, str]) -> Figure:
    """A task's rates with their intervals: methods and baselines one below the other, sheets side by side."""
    labels = list(dict.fromkeys(row.label for row in rows))
    sheets = results.grouped(rows, lambda row: row.sheet)
    with drawing(_SMALL):
        figure = Figure(figsize=(WIDTH, 0.7 + 0.27 * len(labels)), layout="constrained")
        axes = figure.subplots(1, len(sheets), sharey=True, squeeze=False)
        for axis, (sheet, members) in zip(axes[0], sheets.items(), strict=True):
            for row in members:
                color, at = colors.get(row.label, "0.45"), labels.index(row.label)
                axis.plot(row.ci95, [at, at], color=color, lw=2, solid_capstyle="butt", alpha=0.55)
                axis.plot(row.mean, at, "o", color=color, ms=5)
            axis.set_title((sheet or "usual scenes") if len(sheets) > 1 else "")
            axis.set_xlim(-0.03, 1.03)
            # Narrow panels have no room for three signs.
            axis.set_xticks([0, 0.5, 1], ["0", "50", "100 %"])
            axis.grid(axis="x", color="0.87", lw=0.6)
            axis.tick_params(axis="y", length=0)
            axis.spines["left"].set_visible(False)
        axes[0, 0].set_yticks(range(len(labels)), list(map(_beside, labels)))
        axes[0, 0].set_ylim(len(labels) - 0.5, -0.5)
        return figure


def shares(groups: dict[str, list[Run]]) -> Figure | None:
    """Where wall-clock went, by method: the last ``share/…`` of its trainings, averaged."""
    names = columns([run for runs in groups.values() for run in runs], "share")
    means = {
        label: [float(np.mean([run.last(name) for run in runs if run.columns])) for name in names]
        for label, runs in groups.items()
    }
    means = {label: values for label, values in means.items() if sum(values) > 0}
    if not means:
        return None
    with drawing(_SMALL):
        figure = Figure(figsize=(WIDTH, 0.8 + 0.32 * len(means)), layout="constrained")
        axis = figure.subplots()
        left = np.zeros(len(means))
        for i, name in enumerate(names):
            width = np.array([values[i] for values in means.values()])
            axis.barh(
                range(len(means)),
                width,
                left=left,
                color=PALETTE[i % len(PALETTE)],
                label=name.partition("/")[2],
                height=0.7,
            )
            for row, (w, at) in enumerate(zip(width, left, strict=True)):
                if w >= 0.05:
                    axis.text(
                        at + w / 2, row, tables.percent(w, 0), ha="center", va="center", fontsize=8, color="white"
                    )
            left += width
        axis.invert_yaxis()
        axis.set_yticks(range(len(means)), list(map(_beside, means)))
        axis.set_xlim(0, 1)
        axis.set_xticks([])
        axis.tick_params(axis="y", length=0)
        for spine in axis.spines.values():
            spine.set_visible(False)
        axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(names), frameon=False)
        return figure
