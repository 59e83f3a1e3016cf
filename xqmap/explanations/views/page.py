"""A decision, or an episode of them, as one self-contained page: works from disk, asks for nothing outside, readable
without pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from xqmap.explanations.decision import Decision
from xqmap.explanations.views import markup, plots
from xqmap.explanations.views.told import WIDTH, asked, told


def page(decisions: Sequence[Decision], dialogue: Sequence[tuple[str, str]] = (), width: int = WIDTH) -> str:
    """The page as HTML.

    Args:
        decisions: one, or the successive ones of an episode.
        dialogue: questions and answers to show at its end.
        width: of the picture of the maps at most, pixels.
    """
    first, many = decisions[0], len(decisions) > 1
    title = f"Why? {len(decisions)} decisions in {first.task}" if many else f"Why? A decision in {first.task}"
    seed = "" if first.scene_seed is None else f" Scene {first.scene_seed}."
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="soft">Components: {escape(", ".join(first.components))}.{seed}</p>',
    ]
    if many:
        links = "".join(f'<li><a href="#{i}">{escape(d.selected.object)}</a></li>' for i, d in enumerate(decisions))
        caption = "The component values of what was chosen, decision by decision."
        body += ["<h2>Over the episode</h2>", markup.figure(plots.over_time(decisions), caption), f"<ol>{links}</ol>"]
    for i, decision in enumerate(decisions):
        if many:
            body.append(f'<h2 id="{i}">Decision {decision.step + 1}: {escape(decision.selected.object)}</h2>')
        body.append(told(decision, 3 if many else 2, width))
    return markup.document(title, "".join([*body, asked(dialogue, 2)]))
