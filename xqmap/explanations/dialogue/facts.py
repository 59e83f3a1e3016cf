"""Answers about the things themselves: where they lie, how far apart, how high, how large; which one is meant, and
what is said of them that may not be so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.lookups import Answer, called_where, counted_word
from xqmap.explanations.dialogue.mentions import is_own
from xqmap.explanations.dialogue.naming import called, placed, where
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.dialogue.question import Question
from xqmap.explanations.views import sentences
from xqmap.explanations.views.words import listed, number, phrase, sentence, the

# Things whose places one answer tells.
_MOST_PLACED = 8


def place(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Where things lie: in the picture, on the map and in the world."""
    said: list[str] = []
    computed: list[float] = []
    if not question.about and question.pool:
        things = question.pool[:_MOST_PLACED]
        return listed([called_where(c, decision, words) for c in things], words) + ".", [
            float(at) for c in things for at in c.pixel or ()
        ]
    for c in question.about:
        if c.pixel is None:
            said.append(words["answers"]["no_place"].format(object=called(c, decision, words)))
            continue
        x, y, z = c.position or (0.0, 0.0, 0.0)
        key = "where" if c.position is not None else "where_pixel"
        named = {"row": c.pixel[0], "column": c.pixel[1], "x": number(x), "y": number(y), "z": number(z)}
        told = words["answers"][key].format(object=called(c, decision, words), **named)
        if (side := where(c, decision, words)) and side not in told:
            told = f"{words['answers']['where_side'].format(object=called(c, decision, words), place=side)} {told}"
        said.append(told)
        computed += [*c.pixel, x, y, z]
    return " ".join(map(sentence, said)), computed


def distance(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """How far two things lie apart; one thing is measured from the choice."""
    about, say = question.about, words["answers"]
    if len(about) < 2:
        about = [decision.selected, *(c for c in about if not is_own(c))]
    if len(about) < 2:
        return say["distance_of_what"], []
    first, second = about[:2]
    names = {"first": called(first, decision, words), "second": called(second, decision, words)}
    metres, cells = Places(decision).metres(first, second), Places(decision).apart(first, second)
    if metres is not None:
        return say["distance"].format(**names, metres=number(metres)), [metres]
    if not np.isfinite(cells):
        return say["no_place"].format(object=names["second"]), []
    return say["distance_cells"].format(**names, cells=number(cells)), [cells]


def height(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """How high things stand."""
    return _measured(question, decision, words, "height")


def size(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """How large things are, seen from above."""
    return _measured(question, decision, words, "area")


def _measured(question: Question, decision: Decision, words: Mapping[str, Any], which: str) -> Answer:
    places, said, found = Places(decision), [], []
    for c in question.about or (question.pool or [])[:_MOST_PLACED]:
        value = getattr(places, which)(c)
        if value is None:
            said.append(words["answers"][f"no_{which}"].format(object=called(c, decision, words)))
            continue
        # Of square metres two decimals may be none.
        shown = number(value) if value >= 0.1 or which == "height" else f"{value:.4f}"
        said.append(words["answers"][which].format(object=called(c, decision, words), value=shown))
        found += [value, float(shown)]
    return " ".join(map(sentence, said)) or words["answers"]["no_place"].format(object=question.said), found


def which_one(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Asks back: several things fit."""
    shown = [called_where(c, decision, words) for c in question.about[:_MOST_PLACED]]
    count = counted_word(len(question.about), words)
    asked = words["answers"]["which_one"].format(count=count, things=listed(shown, words))
    return asked, [float(len(question.about)), *(float(at) for c in question.about for at in c.pixel or ())]


def misplaced(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """A thing that is there, but not where the question has it."""
    shown = listed([called_where(c, decision, words) for c in question.about[:_MOST_PLACED]], words)
    return words["answers"]["misplaced"].format(thing=question.thing, things=shown), [
        float(at) for c in question.about for at in c.pixel or ()
    ]


def presupposed(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Why none of a sort was chosen, which may not be so."""
    pool, say = question.pool or [], words["answers"]
    others = [c for c in pool if not is_own(c)]
    if any(is_own(c) for c in pool):
        return f"{say['did'].format(object=the(decision.selected.object))} {sentences.shallow(decision, words)}", []
    if not others:
        return say["none_there"].format(things=question.said), []
    return best_of(others, decision, words)


def best_of(others: list[Candidate], decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The choice against the best of several things."""
    best = max(others, key=lambda c: c.overall)
    told = sentences.contrastive(decision, decision.selected, placed(best, decision, words), words)
    if len(others) == 1:
        return told, []
    first = words["answers"]["best_of"].format(
        count=counted_word(len(others), words), best=called(best, decision, words), overall=number(best.overall)
    )
    return f"{sentence(first)} {told}", [float(len(others))]


def identity(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Whether a thing is what the question takes it for."""
    meant = question.about[0] if question.about else decision.selected
    if question.pool is None:
        values = listed([f"{phrase(n, words)} {number(meant.values[n])}" for n in decision.components], words)
        return words["answers"]["is_a"].format(
            this=sentences.referred(meant, words) if is_own(meant) else words["answers"]["this"],
            object=called_where(meant, decision, words) if not is_own(meant) else called(meant, decision, words),
            values=values,
        ), [float(at) for at in meant.pixel or ()]
    yes = any(c is meant for c in question.pool)
    key = "is_so" if yes else "is_not_so"
    own = f", {words['own_choice']} {words['answers']['itself']}" if is_own(meant) else ""
    return words["answers"][key].format(object=called(meant, decision, words) + own, claim=question.said), []


def disagree(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What the decision holds about a thing of which the person says something else."""
    meant = question.about[0] if question.about else decision.selected
    values = listed([f"{phrase(n, words)} {number(meant.values[n])}" for n in decision.components], words)
    names = {"object": called(meant, decision, words), "values": values, "claim": question.said}
    if question.pool and any(c is meant for c in question.pool):
        return words["answers"]["agreed"].format(**names), []
    return words["answers"]["disagreed" if question.said else "doubted"].format(**names), []
