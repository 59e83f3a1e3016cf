"""A decision, or an episode of them, as one self-contained page: works from disk, asks for nothing outside, readable without pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from xqmap.explanations import plots
from xqmap.explanations.decision import Decision
from xqmap.explanations.sentences import number, signed

_STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")


def page(decisions: Sequence[Decision], dialogue: Sequence[tuple[str, str]] = ()) -> str:
    """The page as HTML.

    Args:
        decisions: one, or the successive ones of an episode.
        dialogue: questions and answers to show at its end.
    """
    first = decisions[0]
    title = f"Why? A decision in {first.task}" if len(decisions) == 1 else f"Why? {len(decisions)} decisions in {first.task}"
    seed = "" if first.scene_seed is None else f" Scene {first.scene_seed}."
    body = [f"<h1>{escape(title)}</h1>", f'<p class="soft">Components: {escape(", ".join(first.components))}.{seed}</p>']
    if len(decisions) > 1:
        body += [
            "<h2>Over the episode</h2>",
            _picture(lambda: over_time(decisions), "The selected action's component values, decision by decision."),
        ]
    for decision in decisions:
        body += _decision(decision, heading=len(decisions) > 1)
    if dialogue:
        body.append("<h2>Asked</h2>")
        for question, answer in dialogue:
            body.append(f"<p><strong>{escape(question)}</strong></p><blockquote>{escape(answer)}</blockquote>")
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    )


def over_time(decisions: Sequence[Decision]) -> Figure:
    """How the selected action's values move over an episode: a stacked line of components and their sum."""
    with plt.rc_context(plots.STYLE):
        figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
        steps = [decision.step + 1 for decision in decisions]
        for name in decisions[0].components:
            axis.plot(steps, [d.selected.values[name] for d in decisions], "o-", color=plots.color_of(decisions[0], name), label=name)
        axis.plot(steps, [d.selected.overall for d in decisions], "s--", color="0.25", label="sum")
        axis.set_xticks(steps, [f"{s}\n{d.selected.object}" for s, d in zip(steps, decisions, strict=True)], fontsize=7)
        axis.set_ylabel("value")
        axis.legend(frameon=False, loc="upper left", bbox_to_anchor=(1, 1))
        return figure


def _decision(decision: Decision, heading: bool) -> list[str]:
    said = decision.sentences()
    parts = [f"<h2>Decision {decision.step + 1}: {escape(decision.selected.object)}</h2>" if heading else ""]
    parts += [f"<blockquote>{escape(said['shallow'])}</blockquote>"]
    if decision.maps is not None:
        marks = "; ".join(f"{c.label}: {c.object}" for c in decision.candidates)
        parts.append(
            _picture(
                lambda: plots.qmaps(decision), f"The scene and the Q-Maps over it. ★ selected, letters the best for one component. {marks}."
            )
        )
    parts.append("<h2>Values of the candidates</h2>" if not heading else "<h3>Values of the candidates</h3>")
    parts.append(
        _picture(
            lambda: plots.bars(decision),
            "Component values of each candidate, and differences (RDX) of each pair; the tables hold the same.",
        )
    )
    head = "".join(f"<th>{escape(name)}</th>" for name in decision.components)
    rows = [
        f'<tr><td>{escape(c.label)}</td><td class="text">{escape(c.object)}</td>'
        + "".join(f"<td>{number(c.values[n])}</td>" for n in decision.components)
        + f"<td>{number(c.overall)}</td></tr>"
        for c in decision.candidates
    ]
    parts.append(f'<table><tr><th>candidate</th><th class="text">object</th>{head}<th>sum</th></tr>{"".join(rows)}</table>')
    rows = []
    for a, b in decision.pairs:
        delta = decision.rdx(a, b)
        cells = "".join(f"<td>{signed(delta[n])}</td>" for n in decision.components)
        rows.append(f"<tr><td>{escape(a)} – {escape(b)}</td>{cells}<td>{signed(sum(delta.values()))}</td></tr>")
    parts.append(f"<table><tr><th>pair</th>{head}<th>gap</th></tr>{''.join(rows)}</table>")
    parts.append("<h2>And why not the others?</h2>" if not heading else "<h3>And why not the others?</h3>")
    parts += [f"<p>{escape(sentence)}</p>" for sentence in (*said["contrastive"], said["robustness"])]
    return parts


def _picture(draw: Callable[[], Figure], caption: str) -> str:
    figure, buffer = draw(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    plt.close(figure)
    data = base64.b64encode(buffer.getvalue()).decode()
    caption = escape(caption, quote=True)
    return f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
