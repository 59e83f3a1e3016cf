"""A decision as a piece of a page: the choice and its reasons, the Q-Maps, values and differences, what was asked."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.views import markup, plots
from xqmap.explanations.views.sentences import after
from xqmap.explanations.views.style import rendered
from xqmap.explanations.views.words import number, signed

# Pixels; a row of panels is sharp on a wide screen.
WIDTH = 2000


def told(decision: Decision, level: int, width: int = WIDTH) -> str:
    """One decision as HTML.

    Args:
        decision: what is told.
        level: of its headings.
        width: of the picture of the maps at most, pixels.
    """
    said = decision.sentences()
    parts = decision.foresees
    lines = [
        [c.label, c.object, *(_value(c, n, parts) for n in decision.components), number(c.overall)]
        for c in decision.candidates
    ]
    deltas = {f"{a} − {b}": decision.rdx(a, b) for a, b in decision.pairs}
    differences = [
        [pair, *(signed(delta[n]) for n in decision.components), signed(sum(delta.values()))]
        for pair, delta in deltas.items()
    ]
    body = [
        f"<blockquote>{escape(said['shallow'])}</blockquote>",
        _maps(decision, width) if decision.maps is not None else "",
        f"<h{level}>And why not the others?</h{level}>",
        *(f"<p>{escape(sentence)}</p>" for sentence in after(said)),
        f"<h{level}>Values and differences</h{level}>",
        markup.figure(
            plots.bars(decision),
            "Component values of each candidate, and their differences (RDX); the tables hold the same numbers."
            + (" Solid: what is paid now. Hatched: what is expected to follow." if parts else ""),
        ),
        *(
            [markup.figure(plots.when(decision), "What is expected of each candidate, decision after decision.")]
            if decision.horizon and parts
            else []
        ),
        markup.table(
            ("candidate", "object", *decision.components, "sum"),
            lines,
            f"Values of the candidates{': now + later' if parts else ''}",
            text_columns=2,
        ),
        markup.table(
            ("pair", *decision.components, "gap"),
            differences,
            "Differences; above zero speaks for the first of the pair",
        ),
    ]
    return "".join(body)


def _value(candidate: Candidate, name: str, parts: bool) -> str:
    if not parts or candidate.now is None or candidate.later is None:
        return number(candidate.values[name])
    now, later = candidate.now[name], candidate.later[name]
    return f"{number(candidate.values[name])} ({number(now)} {signed(later)})"


def asked(dialogue: Sequence[tuple[str, str]], level: int) -> str:
    """Questions and answers as HTML; empty where there are none."""
    said = "".join(
        f'<p><strong>{escape(question)}</strong></p><blockquote class="said">{escape(answer)}</blockquote>'
        for question, answer in dialogue
    )
    return f"<h{level}>Asked</h{level}>{said}" if said else ""


def _maps(decision: Decision, width: int) -> str:
    marks = "; ".join(f"{c.label}: {c.object}" for c in decision.candidates)
    caption = (
        "The scene, and the Q-Maps over it. ★ is the choice, letters mark what would be best for one component alone. "
        f"{marks}."
    )
    drawn = rendered(plots.qmaps(decision), "png", dpi=110)
    return f'<div class="maps">{markup.picture(drawn, caption, width)}</div>'
