"""What is looked at and read: Q-Maps over training, and one decision with its reasons and the questions it was
asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.dialogue.conversation import excerpt, saved_conversation
from xqmap.explanations.views import plots
from xqmap.explanations.views.sentences import number, signed
from xqmap.reports import markup
from xqmap.reports.runs import Run

# Pictures in a film strip, and how wide they are, pixels.
FRAMES = 6
WIDTH = 1000


def film_strip(groups: dict[str, list[Run]]) -> list[str]:
    """The Q-Maps over training, of the first training of each method that drew them."""
    strips: dict[str, str] = {}
    for label, runs in groups.items():
        run = next((run for run in runs if run.pictures), None)
        if run is None or run.method in strips:
            continue
        steps = sorted(run.pictures)
        chosen = sorted({steps[round(i * (len(steps) - 1) / max(1, FRAMES - 1))] for i in range(FRAMES)})
        maps = run.settings.get("method.components")
        shown = (
            f": the scene, and over it the Q-Maps of {', '.join(map(str, maps)) if isinstance(maps, list) else label}"
        )
        frames = [
            markup.picture(run.pictures[step], said := f"After {step:,} decisions", WIDTH, said + shown)
            for step in chosen
        ]
        strips[run.method] = f'<h4>{escape(label)}, {escape(run.name)}</h4><div class="film">{"".join(frames)}</div>'
    return ["<h3>Q-Maps over training</h3>", *strips.values()] if strips else []


def decision(runs: Sequence[Run]) -> list[str]:
    """One explained decision of a task, or how to get one."""
    if told := best_told(runs):
        return _explained(*told)
    command = "python -m xqmap.explain run=DIR scene_seed=7"
    return [f"<h3>A decision explained</h3><p>None of these runs holds one yet: <code>{command}</code> adds it.</p>"]


def best_told(runs: Sequence[Run]) -> tuple[Decision, Path, Run] | None:
    """A decision that was explained, its folder and run: of most components, talked about if any was, with much to
    contrast.
    """
    found: list[tuple[tuple[int, bool, int], Decision, Path, Run]] = []
    for run in runs:
        for path in sorted(run.directory.glob("figures/**/decision.json")):
            try:
                read = Decision.load(path)
            except UserError:
                continue
            talked, things = (
                (path.parent / "dialogue.json").exists(),
                {candidate.object for candidate in read.candidates},
            )
            found.append(((-len(read.components), not talked, -len(things)), read, path.parent, run))
    return min(found, key=lambda entry: entry[0])[1:] if found else None


def _explained(chosen: Decision, folder: Path, run: Run) -> list[str]:
    said = chosen.sentences()
    scene = "" if chosen.scene_seed is None else f", scene {chosen.scene_seed}"
    parts = [
        f"<h3>A decision explained</h3><p "
        f"class=soft>{escape(run.name)}{scene}.</p><blockquote>{escape(said['shallow'])}</blockquote>"
    ]
    if (folder / "qmaps.png").exists():
        marks = "; ".join(f"{c.label}: {c.object}" for c in chosen.candidates)
        caption = f"The scene and the Q-Maps over it. ★ selected; letters are best for one component alone. {marks}."
        parts.append(markup.picture(folder / "qmaps.png", caption, 2 * WIDTH))
    caption = (
        "Component values of each candidate, and differences (RDX) of each pair; the tables hold the same numbers."
    )
    parts.append(markup.figure(plots.bars(chosen), caption))
    lines = [
        [c.label, c.object, *(number(c.values[n]) for n in chosen.components), number(c.overall)]
        for c in chosen.candidates
    ]
    parts.append(
        markup.table(
            ("candidate", "object", *chosen.components, "sum"), lines, "Values of the candidates", text_columns=2
        )
    )
    deltas = {pair: chosen.rdx(*pair) for pair in chosen.pairs}
    lines = [
        [f"{a} – {b}", *(signed(d[n]) for n in chosen.components), signed(sum(d.values()))]
        for (a, b), d in deltas.items()
    ]
    parts.append(
        markup.table(
            ("pair", *chosen.components, "gap"), lines, "Differences; above zero speaks for the first of the pair"
        )
    )
    parts += [f"<p>{escape(sentence)}</p>" for sentence in (*said["contrastive"], said["robustness"])]
    if dialogue := asked(chosen, folder):
        parts.append("<h4>Asked</h4>")
        parts += [f"<p><strong>{escape(q)}</strong></p><blockquote>{escape(a)}</blockquote>" for q, a in dialogue]
    return parts


def asked(chosen: Decision, folder: Path) -> list[tuple[str, str]]:
    """What was asked about a decision and answered (``dialogue.json``), or an excerpt of what can be."""
    return saved_conversation(folder / "dialogue.json", chosen) or excerpt(chosen)
