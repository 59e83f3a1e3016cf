"""A decision, or an episode of them, as one self-contained page: works from disk, asks for nothing outside, readable
without pictures.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from xqmap.explanations.decision import Decision
from xqmap.explanations.views import plots
from xqmap.explanations.views.sentences import number, signed
from xqmap.explanations.views.style import rendered

_STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")


def page(decisions: Sequence[Decision], dialogue: Sequence[tuple[str, str]] = ()) -> str:
    """The page as HTML.

    Args:
        decisions: one, or the successive ones of an episode.
        dialogue: questions and answers to show at its end.
    """
    first = decisions[0]
    title = (
        f"Why? A decision in {first.task}"
        if len(decisions) == 1
        else f"Why? {len(decisions)} decisions in {first.task}"
    )
    seed = "" if first.scene_seed is None else f" Scene {first.scene_seed}."
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="soft">Components: {escape(", ".join(first.components))}.{seed}</p>',
    ]
    if len(decisions) > 1:
        caption = "The component values of what was chosen, decision by decision."
        body += ["<h2>Over the episode</h2>", _picture(lambda: plots.over_time(decisions), caption)]
        body += [
            "<ol>",
            *(f'<li><a href="#{i}">{escape(d.selected.object)}</a></li>' for i, d in enumerate(decisions)),
            "</ol>",
        ]
    for i, decision in enumerate(decisions):
        if len(decisions) > 1:
            body.append(f'<h2 id="{i}">Decision {decision.step + 1}: {escape(decision.selected.object)}</h2>')
        body += _decision(decision, level=3 if len(decisions) > 1 else 2)
    if dialogue:
        body.append("<h2>Asked</h2>")
        for question, answer in dialogue:
            body.append(
                f'<p><strong>{escape(question)}</strong></p><blockquote class="said">{escape(answer)}</blockquote>'
            )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def _decision(decision: Decision, level: int) -> list[str]:
    """One decision; ``level`` is that of its headings."""
    said = decision.sentences()
    parts = [f"<blockquote>{escape(said['shallow'])}</blockquote>"]
    if decision.maps is not None:
        marks = "; ".join(f"{c.label}: {c.object}" for c in decision.candidates)
        caption = (
            "The scene, and the Q-Maps over it. ★ is the choice, letters mark what would be best for one "
            "component alone. "
        )
        parts.append(_picture(lambda: plots.qmaps(decision), f"{caption}{marks}."))
    parts += [f"<h{level}>And why not the others?</h{level}>"]
    parts += [f"<p>{escape(sentence)}</p>" for sentence in (*said["contrastive"], said["robustness"])]
    parts.append(f"<h{level}>Values and differences</h{level}>")
    caption = "Component values of each candidate, and their differences (RDX); the tables hold the same numbers."
    parts.append(_picture(lambda: plots.bars(decision), caption))
    head = "".join(f"<th>{escape(name)}</th>" for name in decision.components)
    rows = [
        f'<tr><td>{escape(c.label)}</td><td class="text">{escape(c.object)}</td>'
        + "".join(f"<td>{number(c.values[n])}</td>" for n in decision.components)
        + f"<td>{number(c.overall)}</td></tr>"
        for c in decision.candidates
    ]
    parts.append(_table(f'<tr><th>candidate</th><th class="text">object</th>{head}<th>sum</th></tr>', rows))
    rows = []
    for a, b in decision.pairs:
        delta = decision.rdx(a, b)
        cells = "".join(f"<td>{signed(delta[n])}</td>" for n in decision.components)
        rows.append(f"<tr><td>{escape(a)} − {escape(b)}</td>{cells}<td>{signed(sum(delta.values()))}</td></tr>")
    return [*parts, _table(f"<tr><th>pair</th>{head}<th>gap</th></tr>", rows)]


def _table(head: str, rows: list[str]) -> str:
    return f'<div class="wide"><table>{head}{"".join(rows)}</table></div>'


def _picture(draw: Callable[[], Figure], caption: str) -> str:
    data = base64.b64encode(rendered(draw(), "png", dpi=110)).decode()
    caption = escape(caption, quote=True)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )
