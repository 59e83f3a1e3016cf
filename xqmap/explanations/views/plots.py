"""Charts of a decision."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from xqmap.explanations.decision import Decision
from xqmap.explanations.views import charts
from xqmap.explanations.views.marks import mark
from xqmap.explanations.views.sentences import after
from xqmap.explanations.views.style import PALETTE, Picture, drawing, rendered
from xqmap.files import write_atomically


def qmaps(decision: Decision) -> Figure:
    """Part 1: the scene, each component's Q-Map and their sum over it, with the candidates marked."""
    with drawing():
        _require_maps(decision)
        panels, rows = _panels(decision)
        figure = Picture(
            figsize=(_panel_width(decision) * panels, _panel_height(decision) * rows), layout="constrained"
        )
        _draw_maps(decision, figure)
        return figure


def values(decision: Decision) -> Figure:
    """Part 2a: the component values of every candidate, side by side, and their sum."""
    with drawing():
        width = max(3.6, len(decision.candidates) * (0.7 + 0.2 * len(decision.components)))
        figure = Picture(figsize=(1.8 + width, 3.4), layout="constrained")
        axis = figure.subplots()
        charts.draw_values(decision, axis)
        charts.legend(decision, axis)
        return figure


def rdx(decision: Decision) -> Figure:
    """Part 2b: the differences Δ_k of every pair of candidates (beyond eight components, of the selected one with
    each).
    """
    with drawing():
        pairs = decision.pairs if len(decision.components) <= 8 else charts.own_pairs(decision)
        each = max(4, 40 // len(decision.components))
        rows = [pairs[i : i + each] for i in range(0, len(pairs), each)] or [[]]
        width = max(3.6, len(rows[0]) * (0.7 + 0.2 * len(decision.components)))
        figure = Picture(figsize=(1.8 + width, 3.4 + 2.2 * (len(rows) - 1)), layout="constrained")
        axes = figure.subplots(len(rows), 1, sharey=True, squeeze=False)
        for axis, row in zip(axes[:, 0], rows, strict=True):
            charts.draw_rdx(decision, axis, row)
            axis.set_xlim(-0.6, len(rows[0]) - 0.4)
        for axis in axes[1:, 0]:
            axis.set_title("")
        charts.legend(decision, axes[0, 0])
        return figure


def when(decision: Decision) -> Figure:
    """What is paid now and what is expected of each of the next decisions, where the agent tells them apart; their sum
    is each candidate's value.
    """
    with drawing():
        count = len(decision.candidates)
        ahead = decision.horizon
        if not ahead:
            raise ValueError("this decision does not tell the next decisions apart: qnet.horizon is 0")
        figure = Picture(figsize=(1.4 + count * max(2.6, 0.62 * (ahead + 2)), 2.6), layout="constrained")
        axes = list(figure.subplots(1, count, sharey=True, squeeze=False)[0])
        charts.draw_when(decision, axes)
        charts.legend(decision, axes[-1], played=False)
        return figure


def bars(decision: Decision) -> Figure:
    """Part 2 as one figure: values and differences.

    Examples:
        >>> from xqmap.explanations import Candidate, Decision
        >>> from xqmap.explanations.views import plots
        >>> selected = Candidate("Selected", "blue cube", {"shape": 0.98, "color": 0.81})
        >>> other = Candidate("A", "red cube", {"shape": 1.0, "color": 0.01})
        >>> figure = plots.bars(Decision("grasping", ("shape", "color"), [selected, other]))
        >>> [axis.get_title() for axis in figure.axes]
        ['Values of each candidate', 'Differences (RDX): above zero speaks for the first']
    """
    with drawing():
        figure = Picture(figsize=charts.size(decision), layout="constrained")
        charts.draw(decision, figure)
        return figure


def overview(decision: Decision, dialogue: list[tuple[str, str]] | None = None) -> Figure:
    """The whole explanation as one figure: maps, bars, sentences, and a piece of a dialogue
    ``[(question, answer), …]``.
    """
    with drawing():
        panels, map_rows = _panels(decision)
        bars_width, bars_height = charts.size(decision)
        width = max(11.0 if len(decision.components) > 1 else 8.0, _panel_width(decision) * panels, bars_width)
        said = decision.sentences()
        texts = [[said["shallow"], *after(said)[:-1]], [line for q, a in dialogue or [] for line in (f"— {q}", a)]]
        # About 15 characters of the text's size fit an inch.
        wrapped = [[textwrap.fill(line, int(15 * width)) for line in lines] for lines in texts if lines]
        parts = [("Part 1 · Q-Maps", _panel_height(decision) * map_rows)] if decision.maps is not None else []
        parts += [("Part 2 · values and differences", bars_height)]
        titles = ("Part 3 · why this one, and why not another", "Part 4 · asked")
        parts += [
            (title, 0.45 + 0.19 * sum(1 + line.count("\n") for line in lines))
            for title, lines in zip(titles, wrapped, strict=False)
        ]
        figure = Picture(figsize=(width, sum(height for _, height in parts)), layout="constrained")
        made = figure.subfigures(len(parts), 1, height_ratios=[height for _, height in parts], squeeze=False)[:, 0]
        drawn = list(made)
        for part, (title, _) in zip(made, parts, strict=True):
            part.suptitle(title, x=0.005, ha="left", fontsize=10, color="0.35")
        if decision.maps is not None:
            _draw_maps(decision, drawn.pop(0))
        charts.draw(decision, drawn.pop(0))
        for part, lines in zip(drawn, wrapped, strict=True):
            part.text(
                0.005,
                1 - 0.36 / part.bbox.height * figure.dpi,
                "\n".join(lines),
                fontsize=9,
                va="top",
                linespacing=1.45,
            )
        return figure


def over_time(decisions: Sequence[Decision]) -> Figure:
    """How the values of what was chosen move over an episode: one line per component, and their sum."""
    with drawing():
        figure = Picture(figsize=(max(6.0, 1.8 + 0.62 * len(decisions)), 3.2), layout="constrained")
        axis = figure.subplots()
        steps = [decision.step + 1 for decision in decisions]
        first = decisions[0]
        for name, marker in zip(first.components, itertools.cycle("o^Dv"), strict=False):
            axis.plot(
                steps,
                [d.selected.values[name] for d in decisions],
                f"{marker}-",
                color=charts.color_of(first, name),
                label=name,
            )
        if len(first.components) > 1:
            axis.plot(steps, [d.selected.overall for d in decisions], "s--", color="0.25", label="sum")
        names = [
            "\n".join([str(s), *textwrap.wrap(d.selected.object, 9)]) for s, d in zip(steps, decisions, strict=True)
        ]
        axis.set_xticks(steps, names, fontsize=7)
        axis.set_xlabel("decision, and what was chosen")
        axis.set_ylabel("value")
        axis.legend(frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
        return figure


def save(figure: Figure, path: Path) -> list[Path]:
    """Writes a figure as PNG and SVG; returns the paths."""
    paths = [path.with_suffix(".png"), path.with_suffix(".svg")]
    # Without a date: equal figures are equal files.
    for target, options in zip(paths, ({}, {"metadata": {"Date": None}}), strict=True):
        write_atomically(target, rendered(figure, target.suffix[1:], **options))
    return paths


def _require_maps(decision: Decision) -> np.ndarray:
    if decision.maps is None or decision.heightmap is None:
        raise ValueError("this decision has no maps to draw: it is of actions, or of a file without them")
    return decision.maps


def _panels(decision: Decision) -> tuple[int, int]:
    """How many map panels stand side by side, and in how many rows."""
    count = len(decision.components) + (2 if len(decision.components) > 1 else 1)
    rows = math.ceil(count / 6)
    return math.ceil(count / rows), rows


def _panel_width(decision: Decision) -> float:
    if decision.maps is None:
        return 0.0
    rows, columns = decision.maps.shape[-2:]
    return min(3.2, 0.8 + (_panel_height(decision) - 0.5) * columns / rows)


def _panel_height(decision: Decision) -> float:
    """Inches; a map that is tall gets more of them."""
    return 4.6 if decision.maps is not None and decision.maps.shape[-2] > 1.5 * decision.maps.shape[-1] else 3.4


def _draw_maps(decision: Decision, figure: Any) -> None:
    maps = _require_maps(decision)
    assert decision.heightmap is not None
    columns, rows = _panels(decision)
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    scene = decision.heightmap[:3].transpose(1, 2, 0).astype(np.uint8)
    axes[0].imshow(scene, origin="lower")
    axes[0].set_title("scene")
    panels = list(zip(decision.components, maps, strict=True))
    panels += [("sum", maps.sum(0))] if len(panels) > 1 else []
    for axis, (name, image) in zip(axes[1:], panels, strict=False):
        axis.imshow(scene.mean(-1) / 255, origin="lower", cmap="gray", vmin=0, vmax=1.4)
        low, high = np.nanquantile(image, [0.01, 1.0])
        drawn = axis.imshow(image, origin="lower", cmap="viridis", vmin=low, vmax=max(high, low + 1e-6), alpha=0.9)
        bar = axis.figure.colorbar(drawn, ax=axis, shrink=0.8, pad=0.03)
        bar.ax.tick_params(labelsize=7)
        axis.set_title(name, fontweight="bold")
    for i, axis in enumerate(axes):
        axis.set_xticks([])
        axis.set_yticks([])
        # The frame is in the component's colour, which a title would be too thin to show.
        framed = 1 <= i <= len(decision.components)
        for spine in axis.spines.values():
            spine.set(visible=framed, linewidth=3, color=PALETTE[(i - 1) % len(PALETTE)])
        if i <= len(panels):
            # Points of the page to a cell, about.
            mark(decision, axis, 72 * (_panel_height(decision) - 0.6) / decision.heightmap.shape[-2])
