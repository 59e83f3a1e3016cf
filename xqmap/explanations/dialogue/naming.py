"""What the things of a decision are called in an answer, so that no two are taken for each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from xqmap.explanations.candidate import SELECTED, Candidate, together
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.views.words import another, the


def is_listed(thing: Candidate, decision: Decision) -> bool:
    """Whether a thing is one of the candidates."""
    return any(together(thing, candidate) for candidate in decision.candidates)


def called(candidate: Candidate, decision: Decision, words: Mapping[str, Any]) -> str:
    """A thing in an answer: "the ground (A)"; one that bears the chosen one's name, but is not it, is "another" one,
    and of several namesakes it is said where they lie.
    """
    if candidate.label == SELECTED:
        return the(candidate.object)
    here = [
        c for c in decision.alternatives if (c.object, c.object_index) == (candidate.object, candidate.object_index)
    ]
    if candidate.label == candidate.object and here and all(c.pixel != candidate.pixel for c in here):
        # A candidate lies on it too, elsewhere.
        return words["answers"]["best_spot"].format(object=the(candidate.object), label=here[0].label)
    name = the(_apart(candidate, decision, words))
    return name if candidate.label in ("", candidate.object) else f"{name} ({candidate.label})"


def placed(candidate: Candidate, decision: Decision, words: Mapping[str, Any]) -> Candidate:
    """A thing for a sentence of :mod:`xqmap.explanations.views.sentences`, under a name that only it has."""
    if candidate.label not in ("", candidate.object):
        return candidate
    name = _apart(candidate, decision, words)
    return replace(candidate, object=name, label=name)


def where(thing: Candidate, decision: Decision, words: Mapping[str, Any]) -> str:
    """Where a thing lies in the picture, in words: "at the top left"; empty where that is unknown."""
    return str(words["answers"]["places"].get(Places(decision).place(thing), ""))


def _apart(candidate: Candidate, decision: Decision, words: Mapping[str, Any]) -> str:
    chosen, name, say = decision.selected, candidate.object, words["answers"]
    if name == chosen.object and not together(candidate, chosen):
        name = another(candidate, words)
    if candidate.object_index is None or candidate.label not in ("", candidate.object):
        return name
    places = Places(decision)
    alike = [c for c in places.things if c.object == candidate.object and not together(c, candidate)]
    alone = not alike and candidate.object != chosen.object
    place = where(candidate, decision, words)
    if alone or not place:
        return name
    if any(places.place(c) == places.place(candidate) for c in alike) and candidate.pixel is not None:
        return say["placed_cell"].format(object=name, place=place, row=candidate.pixel[0], column=candidate.pixel[1])
    return say["placed"].format(object=name, place=place)
