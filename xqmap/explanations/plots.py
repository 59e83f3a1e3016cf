"""Charts of a decision. Colours are Okabe and Ito's, which colour-blind people can tell apart; a component keeps its own everywhere."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from xqmap.checkpoint import replacing
from xqmap.explanations.decision import SELECTED, Decision
from xqmap.explanations.sentences import number, signed

PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#F0E442", "#000000")
STYLE: Any = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 11,
    "figure.dpi": 130,
    "savefig.bbox": "tight",
    "svg.hashsalt": "xqmap",
}


def color_of(decision: Decision, component: str) -> str:
    """The colour of a component, the same in every chart."""
    return PALETTE[decision.components.index(component) % len(PALETTE)]


def qmaps(decision: Decision) -> Figure:
    """Part 1: the scene, each component's Q-Map and their sum over it, with the candidates marked."""
    with plt.rc_context(STYLE):
        panels = len(decision.components) + 2
        rows, columns = _maps(decision).shape[-2:]
        tall = rows > columns
        figure, axes = plt.subplots(1, panels, figsize=(2.9 * panels if not tall else 2.1 * panels, 3.4), layout="constrained")
        _draw_maps(decision, list(axes))
        return figure


def values(decision: Decision) -> Figure:
    """Part 2a: the component values of every candidate, side by side, and their sum."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(1.8 + 1.5 * len(decision.candidates), 3.4), layout="constrained")
        _draw_values(decision, axes)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)
        return figure


def rdx(decision: Decision) -> Figure:
    """Part 2b: the differences Δ_k of every pair of candidates; bars to the right of zero speak for the first of the pair."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(1.8 + 1.5 * len(decision.pairs), 3.4), layout="constrained")
        _draw_rdx(decision, axes)
        return figure


def bars(decision: Decision) -> Figure:
    """Part 2 as one figure: values and differences."""
    with plt.rc_context(STYLE):
        count = len(decision.candidates) + len(decision.pairs)
        figure, axes = plt.subplots(
            1, 2, figsize=(3 + 1.3 * count, 3.4), layout="constrained", width_ratios=(len(decision.candidates), len(decision.pairs))
        )
        _draw_values(decision, axes[0])
        _draw_rdx(decision, axes[1])
        return figure


def overview(decision: Decision, dialogue: list[tuple[str, str]] | None = None) -> Figure:
    """The whole explanation as one figure: maps, bars, sentences, and a piece of a dialogue ``[(question, answer), …]``."""
    with plt.rc_context(STYLE):
        panels = len(decision.components) + 2
        figure = plt.figure(figsize=(max(11, 2.9 * panels), 10.5 if dialogue else 8.6), layout="constrained")
        parts: Any = figure.subfigures(4 if dialogue else 3, 1, height_ratios=(3.4, 3.2, 2.0, 1.9)[: 4 if dialogue else 3])
        if decision.maps is not None:
            _draw_maps(decision, list(np.atleast_1d(parts[0].subplots(1, panels))))
        else:
            parts[0].text(0.5, 0.5, "the decision was read from a file without maps", ha="center", va="center")
        axes = parts[1].subplots(1, 2, width_ratios=(len(decision.candidates), len(decision.pairs)))
        _draw_values(decision, axes[0])
        _draw_rdx(decision, axes[1])
        said = decision.sentences()
        _write(parts[2], "Why this one, and why not another?", [said["shallow"], *said["contrastive"]])
        if dialogue:
            _write(parts[3], "Asked", [line for q, a in dialogue for line in (f"— {q}", a)])
        for part, title in zip(parts, ("Part 1 · Q-Maps", "Part 2 · values and differences", "Part 3", "Part 4"), strict=False):
            part.suptitle(title, x=0.005, ha="left", fontsize=10, color="0.35")
        return figure


def save(figure: Figure, path: Path) -> list[Path]:
    """Writes a figure as PNG and SVG; returns the paths."""
    paths = [path.with_suffix(".png"), path.with_suffix(".svg")]
    for target in paths:
        with replacing(target) as beside:
            figure.savefig(beside, format=target.suffix[1:], metadata={"Date": None} if target.suffix == ".svg" else None)
    plt.close(figure)
    return paths


def _maps(decision: Decision) -> np.ndarray:
    if decision.maps is None or decision.heightmap is None:
        raise ValueError("this decision was read from a file and has no maps to draw")
    return decision.maps


def _draw_maps(decision: Decision, axes: list[Axes]) -> None:
    maps = _maps(decision)
    assert decision.heightmap is not None
    scene = decision.heightmap[:3].transpose(1, 2, 0).astype(np.uint8)
    axes[0].imshow(scene, origin="lower")
    axes[0].set_title("scene")
    panels = [*zip(decision.components, maps, strict=True), ("sum", maps.sum(0))]
    for axis, (name, image) in zip(axes[1:], panels, strict=True):
        gray = scene.mean(-1) / 255
        axis.imshow(gray, origin="lower", cmap="gray", vmin=0, vmax=1.4)
        low, high = np.nanquantile(image, [0.01, 1.0])
        drawn = axis.imshow(image, origin="lower", cmap="viridis", vmin=low, vmax=max(high, low + 1e-6), alpha=0.85)
        bar = axis.figure.colorbar(drawn, ax=axis, shrink=0.8, pad=0.02)
        bar.ax.tick_params(labelsize=7)
        axis.set_title(name, color="black" if name == "sum" else color_of(decision, name), fontweight="bold")
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
        for spine in axis.spines.values():
            spine.set_visible(False)
        _mark(decision, axis)


def _mark(decision: Decision, axis: Axes) -> None:
    """Marks each candidate's cell; labels that share a cell stand together."""
    cells: dict[tuple[int, int], list[str]] = {}
    for candidate in decision.candidates:
        if candidate.pixel is not None:
            cells.setdefault(candidate.pixel, []).append(candidate.label)
    assert decision.heightmap is not None
    rows, columns = decision.heightmap.shape[-2:]
    for (row, column), labels in cells.items():
        own = SELECTED in labels
        axis.plot(column, row, "*" if own else "o", ms=13 if own else 7, mfc="white" if own else "none", mec="black", mew=1.1)
        axis.plot(column, row, "o", ms=0 if own else 9, mfc="none", mec="white", mew=0.8)
        # Towards the middle, so that no label leaves the map.
        away = (-9 if column > columns / 2 else 9, -9 if row > rows / 2 else 9)
        axis.annotate(
            ", ".join(label if label != SELECTED else "★" for label in labels),
            (column, row),
            xytext=away,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8,
            fontfamily="DejaVu Sans",
            bbox={"boxstyle": "round,pad=0.2", "fc": "white", "ec": "0.3", "lw": 0.6, "alpha": 0.9},
        )


def _draw_values(decision: Decision, axis: Axes) -> None:
    groups = [candidate.values for candidate in decision.candidates]
    _grouped(decision, axis, groups, number)
    for i, candidate in enumerate(decision.candidates):
        axis.plot([i - 0.42, i + 0.42], [candidate.overall] * 2, color="0.25", lw=1.4)
        # Above the tallest bar of the group and its number.
        top = max(candidate.overall, *candidate.values.values(), 0.0)
        text = f"Σ {number(candidate.overall)}"
        axis.annotate(text, (i, top), xytext=(0, 11), textcoords="offset points", ha="center", fontsize=8, fontweight="bold")
    axis.set_xticks(range(len(groups)), ["\n".join([c.label, *textwrap.wrap(c.object, 12)]) for c in decision.candidates], fontsize=8)
    axis.set_ylabel("value")
    axis.set_title("Values of each candidate")
    axis.margins(y=0.2)


def _draw_rdx(decision: Decision, axis: Axes) -> None:
    _grouped(decision, axis, [decision.rdx(*pair) for pair in decision.pairs], signed)
    axis.set_xticks(range(len(decision.pairs)), [f"{a} –\n{b}" for a, b in decision.pairs], fontsize=8)
    axis.set_ylabel("difference")
    axis.set_title("Differences (RDX): above zero speaks for the first")
    axis.margins(y=0.15)
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)


def _grouped(decision: Decision, axis: Axes, groups: list[dict[str, float]], form: Any) -> None:
    count = len(decision.components)
    width = 0.8 / count
    for k, name in enumerate(decision.components):
        places = [i + (k - (count - 1) / 2) * width for i in range(len(groups))]
        heights = [group[name] for group in groups]
        drawn = axis.bar(places, heights, width * 0.94, color=color_of(decision, name), label=name)
        if count <= 4:
            axis.bar_label(drawn, [form(height) for height in heights], fontsize=7, padding=1.5, color="0.3")
    axis.axhline(0, color="0.3", lw=0.8)


def _write(part: Any, title: str, lines: list[str]) -> None:
    wrapped = [textwrap.fill(line.replace("$", r"\$"), 150) for line in lines]
    part.text(0.01, 0.86, title, fontsize=10, fontweight="bold", va="top")
    part.text(0.01, 0.70, "\n".join(wrapped), fontsize=9, va="top", linespacing=1.45)
