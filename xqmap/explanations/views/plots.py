"""Charts of a decision."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from xqmap.explanations.candidate import SELECTED
from xqmap.explanations.decision import Decision
from xqmap.explanations.views.marks import mark
from xqmap.explanations.views.sentences import number, signed
from xqmap.explanations.views.style import PALETTE, Picture, drawing, rendered
from xqmap.files import write_atomically

# Behind a number that a line may cross.
_CLEAR = {"fc": "white", "ec": "none", "pad": 0.4}


def color_of(decision: Decision, component: str) -> str:
    """The colour of a component, the same in every chart."""
    return PALETTE[decision.components.index(component) % len(PALETTE)]


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
        _draw_values(decision, axis)
        _legend(decision, axis)
        return figure


def rdx(decision: Decision) -> Figure:
    """Part 2b: the differences Δ_k of every pair of candidates (beyond eight components, of the selected one with
    each).
    """
    with drawing():
        pairs = decision.pairs if len(decision.components) <= 8 else _own_pairs(decision)
        each = max(4, 40 // len(decision.components))
        rows = [pairs[i : i + each] for i in range(0, len(pairs), each)] or [[]]
        width = max(3.6, len(rows[0]) * (0.7 + 0.2 * len(decision.components)))
        figure = Picture(figsize=(1.8 + width, 3.4 + 2.2 * (len(rows) - 1)), layout="constrained")
        axes = figure.subplots(len(rows), 1, sharey=True, squeeze=False)
        for axis, row in zip(axes[:, 0], rows, strict=True):
            _draw_rdx(decision, axis, row)
            axis.set_xlim(-0.6, len(rows[0]) - 0.4)
        for axis in axes[1:, 0]:
            axis.set_title("")
        _legend(decision, axes[0, 0])
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
        figure = Picture(figsize=_bars_size(decision), layout="constrained")
        _draw_bars(decision, figure)
        return figure


def overview(decision: Decision, dialogue: list[tuple[str, str]] | None = None) -> Figure:
    """The whole explanation as one figure: maps, bars, sentences, and a piece of a dialogue
    ``[(question, answer), …]``.
    """
    with drawing():
        panels, map_rows = _panels(decision)
        bars_width, bars_height = _bars_size(decision)
        width = max(11.0 if len(decision.components) > 1 else 8.0, _panel_width(decision) * panels, bars_width)
        said = decision.sentences()
        texts = [[said["shallow"], *said["contrastive"]], [line for q, a in dialogue or [] for line in (f"— {q}", a)]]
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
        _draw_bars(decision, drawn.pop(0))
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
                color=color_of(first, name),
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


def _stacked(decision: Decision) -> bool:
    return len(decision.components) > 3


def _own_pairs(decision: Decision) -> list[tuple[str, str]]:
    return [(SELECTED, candidate.label) for candidate in decision.alternatives]


def _bars_size(decision: Decision) -> tuple[float, float]:
    each = 0.7 + 0.2 * len(decision.components)
    if _stacked(decision):
        return 1.8 + len(decision.candidates) * each, 6.4
    return max(8.0, 2.6 + each * (len(decision.candidates) + len(decision.pairs))), 3.4


def _draw_bars(decision: Decision, figure: Any) -> None:
    """Values and differences side by side; with many components one above the other, and the differences to the choice
    only.
    """
    if _stacked(decision):
        axes = figure.subplots(2, 1)
    else:
        axes = figure.subplots(1, 2, width_ratios=(len(decision.candidates), max(1, len(decision.pairs))))
    _draw_values(decision, axes[0])
    _draw_rdx(decision, axes[1], _own_pairs(decision) if _stacked(decision) else decision.pairs)
    _legend(decision, axes[0] if _stacked(decision) else axes[1])


def _draw_values(decision: Decision, axis: Axes) -> None:
    groups = [candidate.values for candidate in decision.candidates]
    _grouped(decision, axis, groups, number)
    for i, candidate in enumerate(decision.candidates if len(decision.components) > 1 else []):
        axis.plot([i - 0.42, i + 0.42], [candidate.overall] * 2, color="0.25", lw=1.4)
        # Above the tallest bar of the group and its number.
        top = max(candidate.overall, *candidate.values.values(), 0.0)
        text = f"Σ {number(candidate.overall)}"
        axis.annotate(
            text, (i, top), xytext=(0, 11), textcoords="offset points", ha="center", fontsize=8, fontweight="bold"
        )
    axis.set_xticks(
        range(len(groups)),
        ["\n".join([c.label, *textwrap.wrap(c.object, 14)]) for c in decision.candidates],
        fontsize=8,
    )
    axis.set_ylabel("value")
    axis.set_title("Values of each candidate")
    axis.margins(y=0.2)


def _draw_rdx(decision: Decision, axis: Axes, pairs: list[tuple[str, str]]) -> None:
    _grouped(decision, axis, [decision.rdx(*pair) for pair in pairs], signed)
    axis.set_xticks(range(len(pairs)), [f"{a} − {b}" for a, b in pairs], fontsize=8)
    axis.set_ylabel("difference")
    axis.set_title("Differences (RDX): above zero speaks for the first")
    axis.margins(y=0.15)
    # Differences that are nothing beside the values look like it.
    reach = max(abs(value) for candidate in decision.candidates for value in candidate.values.values()) / 4 or 1.0
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -reach), max(high, reach))


def _legend(decision: Decision, axis: Axes) -> None:
    handles = [Patch(color=color_of(decision, name), label=name) for name in decision.components]
    axis.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)


def _grouped(decision: Decision, axis: Axes, groups: list[dict[str, float]], form: Any) -> None:
    count = len(decision.components)
    width = 0.8 / count
    for k, name in enumerate(decision.components):
        places = [i + (k - (count - 1) / 2) * width for i in range(len(groups))]
        heights = [group[name] for group in groups]
        drawn = axis.bar(places, heights, width * 0.94, color=color_of(decision, name))
        if count <= 4:
            axis.bar_label(
                drawn, [form(height) for height in heights], fontsize=7, padding=1.5, color="0.3", bbox=_CLEAR
            )
    axis.axhline(0, color="0.3", lw=0.8)
