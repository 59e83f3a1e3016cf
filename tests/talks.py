"""A decision of each task to talk about."""

from __future__ import annotations

from typing import Any

from xqmap.explanations import Candidate, Decision
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.views.sentences import wording_for

SCENES: dict[str, list[tuple[str, tuple[float, float]]]] = {
    "landing": [
        ("blue flat block", (0.97, 0.99)),
        ("ground", (1.01, 0.02)),
        ("red inclined block", (0.05, 1.03)),
        ("gray flat block", (0.96, 0.03)),
    ],
    "grasping": [
        ("blue cube", (0.98, 0.81)),
        ("red cube", (1.0, 0.02)),
        ("purple bowl", (0.03, 1.0)),
        ("green bowl", (0.02, 0.61)),
    ],
}


def decision(task: str = "landing") -> Decision:
    names = ("flatness", "color") if task == "landing" else ("shape", "color")
    things = [(thing, dict(zip(names, values, strict=True))) for thing, values in SCENES[task]]
    candidates = [
        Candidate(k, thing, v, (i, i), None, i)
        for i, (k, (thing, v)) in enumerate(zip(["Selected", "A", "B"], things, strict=False))
    ]
    objects = [Candidate(thing, thing, v, (i, i), None, i) for i, (thing, v) in enumerate(things)]
    for thing in (*candidates, *objects):
        thing.object_index = None if thing.object == "ground" else thing.object_index
    objects.sort(key=lambda thing: -thing.overall)
    return Decision(task, names, candidates, objects=objects, noise=dict.fromkeys(names, 0.04))


def dialogue(task: str = "landing", model: Any = None) -> Dialogue:
    return Dialogue(decision(task), wording_for(task), model)
