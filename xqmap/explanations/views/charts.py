"""The bars of a decision: the candidates' values and their differences."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from xqmap.explanations.candidate import SELECTED
from xqmap.explanations.decision import Decision
from xqmap.explanations.views.style import PALETTE
from xqmap.explanations.views.words import number, signed

# What can follow: light enough to see what is paid now through it.
_FOLLOWS: Any = {"fc": (1.0, 1.0, 1.0, 0.75), "lw": 1.0, "hatch": "////"}
# What really came.
_PLAYED: Any = {"marker": "D", "ms": 4.5, "mfc": "white", "mec": "black", "mew": 1.0, "ls": "none"}
# Behind a number that a line may cross.
_CLEAR = {"fc": "white", "ec": "none", "pad": 0.4}


def color_of(decision: Decision, component: str) -> str:
    """The colour of a component, the same in every chart."""
    return PALETTE[decision.components.index(component) % len(PALETTE)]


def stacked(decision: Decision) -> bool:
    """Whether values and differences stand one above the other: with many components."""
    return len(decision.components) > 3


def own_pairs(decision: Decision) -> list[tuple[str, str]]:
    """The chosen candidate with each other."""
    return [(SELECTED, candidate.label) for candidate in decision.alternatives]


def size(decision: Decision) -> tuple[float, float]:
    """Width and height of :func:`draw`, inches."""
    each = 0.7 + 0.2 * len(decision.components)
    if stacked(decision):
        return 1.8 + len(decision.candidates) * each, 6.4
    return max(8.0, 2.6 + each * (len(decision.candidates) + len(decision.pairs))), 3.4


def draw(decision: Decision, figure: Any) -> None:
    """Values and differences side by side; with many components one above the other, and the differences to the choice
    only.
    """
    if stacked(decision):
        axes = figure.subplots(2, 1)
    else:
        axes = figure.subplots(1, 2, width_ratios=(len(decision.candidates), max(1, len(decision.pairs))))
    draw_values(decision, axes[0])
    draw_rdx(decision, axes[1], own_pairs(decision) if stacked(decision) else decision.pairs)
    legend(decision, axes[0] if stacked(decision) else axes[1])


def draw_values(decision: Decision, axis: Axes) -> None:
    """The component values of every candidate, and their sum."""
    groups = [candidate.values for candidate in decision.candidates]
    _grouped(decision, axis, groups, [candidate.now for candidate in decision.candidates], number)
    _draw_played(decision, axis)
    for i, candidate in enumerate(decision.candidates if len(decision.components) > 1 else []):
        axis.plot([i - 0.42, i + 0.42], [candidate.overall] * 2, color="0.25", lw=1.4)
        # Above the tallest bar of the group and its number.
        top = max(candidate.overall, *candidate.values.values(), *(candidate.now or {}).values(), 0.0)
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
    _fit(axis, 0.2)


def _draw_played(decision: Decision, axis: Axes) -> None:
    count = len(decision.components)
    for i, candidate in enumerate(decision.candidates):
        for returns in decision.played.get(candidate.label, []):
            places = [i + (k - (count - 1) / 2 + 0.25) * 0.8 / count for k in range(count)]
            axis.plot(places, [returns[name] for name in decision.components], **_PLAYED, zorder=5)


def draw_rdx(decision: Decision, axis: Axes, pairs: list[tuple[str, str]]) -> None:
    """The differences Δ_k of ``pairs`` of candidates."""
    _grouped(
        decision, axis, [decision.rdx(*pair) for pair in pairs], [decision.sooner(*pair) for pair in pairs], signed
    )
    axis.set_xticks(range(len(pairs)), [f"{a} − {b}" for a, b in pairs], fontsize=8)
    axis.set_ylabel("difference")
    axis.set_title("Differences (RDX): above zero speaks for the first")
    _fit(axis, 0.15)
    # Differences that are nothing beside the values look like it.
    reach = max(abs(value) for candidate in decision.candidates for value in candidate.values.values()) / 4 or 1.0
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -reach), max(high, reach))


def draw_when(decision: Decision, axes: Sequence[Axes]) -> None:
    """What is expected of each candidate, decision after decision, one strip for each."""
    for axis, candidate in zip(axes, decision.candidates, strict=True):
        assert candidate.parts is not None
        count, ahead = len(decision.components), len(next(iter(candidate.parts.values())))
        width = 0.8 / count
        for k, name in enumerate(decision.components):
            places = [h + (k - (count - 1) / 2) * width for h in range(ahead)]
            color = color_of(decision, name)
            drawn = axis.bar(places[:1], candidate.parts[name][:1], width * 0.94, color=color)
            axis.bar_label(drawn, fmt=number, fontsize=7, padding=1.5, color="0.3")
            drawn = axis.bar(places[1:], candidate.parts[name][1:], width * 0.94, ec=color, **_FOLLOWS)
            axis.bar_label(drawn, fmt=number, fontsize=7, padding=1.5, color="0.3")
        axis.axhline(0, color="0.3", lw=0.8)
        axis.set_xticks(range(ahead), ["now", *(f"+{h}" for h in range(1, ahead - 1)), "after"], fontsize=8)
        axis.set_title(f"{candidate.label}: {candidate.object}", fontsize=9)
        axis.margins(y=0.2)
    axes[0].set_ylabel("value, discounted")


def _fit(axis: Axes, margin: float) -> None:
    """Room for the numbers beyond the bars, where there are any: a bar that begins where another ends takes none."""
    axis.use_sticky_edges = False
    axis.margins(y=margin)
    ends = [
        end
        for bar in axis.patches
        if isinstance(bar, Rectangle)
        for end in (bar.get_y(), bar.get_y() + bar.get_height())
    ]
    # Little below zero needs no room.
    if ends and min(ends) > -0.1 * max(ends):
        axis.set_ylim(bottom=1.5 * min(0.0, *ends))


def legend(decision: Decision, axis: Axes, played: bool = True) -> None:
    """Which color is which component, what is hatched, and, where any is ``played``, what came."""
    handles: list[Artist] = [Patch(color=color_of(decision, name), label=name) for name in decision.components]
    if decision.foresees:
        handles += [Patch(color="0.45", label="paid now")]
        handles += [Patch(ec="0.45", label="can follow", **_FOLLOWS)]
    if played and decision.played:
        handles += [Line2D([], [], **_PLAYED, label="came, when played")]
    axis.legend(handles=handles, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=9)


def _grouped(
    decision: Decision,
    axis: Axes,
    groups: list[dict[str, float]],
    sooner: list[dict[str, float] | None],
    form: Any,
) -> None:
    """Bars of each group, one per component; of a value that has two parts, what is paid now is solid and what can
    follow hatched.
    """
    count = len(decision.components)
    width = 0.8 / count
    for k, name in enumerate(decision.components):
        places = [i + (k - (count - 1) / 2) * width for i in range(len(groups))]
        heights = [group[name] for group in groups]
        solid = [
            height if part is None or not decision.foresees else part[name]
            for height, part in zip(heights, sooner, strict=True)
        ]
        color = color_of(decision, name)
        axis.bar(places, solid, width * 0.94, color=color)
        rest = [height - part for height, part in zip(heights, solid, strict=True)]
        if any(rest):
            axis.bar(places, rest, width * 0.94, solid, ec=color, **_FOLLOWS)
        for place, height, part in zip(places, heights, solid, strict=True) if count <= 4 else ():
            below = height < 0
            axis.annotate(
                form(height),
                (place, min(height, part) if below else max(height, part)),
                xytext=(0, -1.5 if below else 1.5),
                textcoords="offset points",
                ha="center",
                va="top" if below else "bottom",
                fontsize=7,
                color="0.3",
                bbox=_CLEAR,
            )
    axis.axhline(0, color="0.3", lw=0.8)
