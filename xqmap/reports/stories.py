"""What is looked at and read: Q-Maps over training, and one decision with its reasons and the questions it was asked."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

from xqmap.errors import UserError
from xqmap.explanations import Decision, plots
from xqmap.explanations.dialogue import excerpt
from xqmap.explanations.sentences import number, signed
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
        frames = [
            markup.picture(
                run.pictures[step], f"After {step:,} decisions: the scene, the Q-Maps of {run.method} over it, and their sum", WIDTH
            )
            for step in chosen
        ]
        strips[run.method] = f'<h4>{escape(label)}, {escape(run.name)}</h4><div class="film">{"".join(frames)}</div>'
    return ["<h3>Q-Maps over training</h3>", *strips.values()] if strips else []


def decision(runs: Sequence[Run]) -> list[str]:
    """One explained decision of a task: of a method with most components, talked about if any was, with much to contrast."""
    found: list[tuple[tuple[int, bool, int], Decision, Path, Run]] = []
    for run in runs:
        for path in sorted(run.directory.glob("figures/**/decision.json")):
            try:
                read = Decision.load(path)
            except UserError:
                continue
            talked, things = (path.parent / "dialogue.json").exists(), {candidate.object for candidate in read.candidates}
            found.append(((-len(read.components), not talked, -len(things)), read, path.parent, run))
    if not found:
        command = "python -m xqmap.explain run=DIR scene_seed=7"
        return [f"<h3>A decision explained</h3><p>None of these runs holds one yet: <code>{command}</code> adds it.</p>"]
    _, chosen, folder, run = min(found, key=lambda entry: entry[0])
    return _explained(chosen, folder, run)


def _explained(chosen: Decision, folder: Path, run: Run) -> list[str]:
    said = chosen.sentences()
    scene = "" if chosen.scene_seed is None else f", scene {chosen.scene_seed}"
    parts = [f"<h3>A decision explained</h3><p class=soft>{escape(run.name)}{scene}.</p><blockquote>{escape(said['shallow'])}</blockquote>"]
    if (folder / "qmaps.png").exists():
        marks = "; ".join(f"{c.label}: {c.object}" for c in chosen.candidates)
        caption = f"The scene and the Q-Maps over it. ★ selected; letters are best for one component alone. {marks}."
        parts.append(markup.picture(folder / "qmaps.png", caption, 2 * WIDTH))
    caption = "Component values of each candidate, and differences (RDX) of each pair; the tables hold the same numbers."
    parts.append(markup.figure(plots.bars(chosen), caption))
    lines = [[c.label, c.object, *(number(c.values[n]) for n in chosen.components), number(c.overall)] for c in chosen.candidates]
    parts.append(markup.table(("candidate", "object", *chosen.components, "sum"), lines, "Values of the candidates", text_columns=2))
    deltas = {pair: chosen.rdx(*pair) for pair in chosen.pairs}
    lines = [[f"{a} – {b}", *(signed(d[n]) for n in chosen.components), signed(sum(d.values()))] for (a, b), d in deltas.items()]
    parts.append(markup.table(("pair", *chosen.components, "gap"), lines, "Differences; above zero speaks for the first of the pair"))
    parts += [f"<p>{escape(sentence)}</p>" for sentence in (*said["contrastive"], said["robustness"])]
    if dialogue := _dialogue(folder / "dialogue.json") or excerpt(chosen):
        parts.append("<h4>Asked</h4>")
        parts += [f"<p><strong>{escape(q)}</strong></p><blockquote>{escape(a)}</blockquote>" for q, a in dialogue]
    return parts


def _dialogue(path: Path) -> list[tuple[str, str]]:
    """The questions and answers of a saved conversation; none where there is no such file or it is damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return [(str(entry["question"]), str(entry["answer"])) for entry in content["exchanges"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []
