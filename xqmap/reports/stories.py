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
from xqmap.explanations.views import markup
from xqmap.explanations.views.told import asked, told
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
    if found := best_told(runs):
        return _explained(*found)
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
    scene = "" if chosen.scene_seed is None else f", scene {chosen.scene_seed}"
    return [
        f"<h3>A decision explained</h3><p class=soft>{escape(run.name)}{scene}.</p>",
        told(chosen, 4),
        asked(dialogue(chosen, folder), 4),
    ]


def dialogue(chosen: Decision, folder: Path) -> list[tuple[str, str]]:
    """What was asked about a decision and answered (``dialogue.json``), or an excerpt of what can be."""
    return saved_conversation(folder / "dialogue.json", chosen) or excerpt(chosen)
