"""A decision whose things bear names of another language, as its wording spells them (``nouns``, ``adjectives``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.decision import Decision


def translated(decision: Decision, words: Mapping[str, Any]) -> Decision:
    """The decision in the wording's language; the same where the wording has no names of its own."""
    if "nouns" not in words:
        return decision
    scene = decision.scene
    if scene is not None:
        names = [_name(name, words) for name in scene.names]
        scene = replace(scene, names=names, background=_name(scene.background, words))
    return replace(
        decision,
        candidates=[_renamed(c, words) for c in decision.candidates],
        objects=[_renamed(thing, words) for thing in decision.objects],
        scene=scene,
    )


def _renamed(candidate: Candidate, words: Mapping[str, Any]) -> Candidate:
    name = _name(candidate.object, words)
    return replace(candidate, object=name, label=name if candidate.label == candidate.object else candidate.label)


def _name(name: str, words: Mapping[str, Any]) -> str:
    """A name in quotation marks, with the endings that its noun asks for; a name that is not listed as it is."""
    *looks, noun = name.split()
    if noun not in words["nouns"] or not set(looks) <= set(words["adjectives"]):
        return f"»{name}«"
    thing, ending = words["nouns"][noun]
    return f"»{' '.join([*(words['adjectives'][look] + ending for look in looks), thing])}«"
