"""Answers that look something up in a decision: its values, things, places and numbers. The wording is the task's, as
in ``answers``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xqmap.explanations import contrast
from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.naming import called, is_listed, where
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.dialogue.question import Question
from xqmap.explanations.views.words import listed, number, phrase, sentence, the

# An answer, and the numbers in it that were computed for it (values under other weights, counts).
Answer = tuple[str, list[float]]
# Objects that one answer lists at most, and what one number may be.
_MOST_LISTED, _MOST_FOUND = 12, 4


def wording(key: str, decision: Decision, words: Mapping[str, Any]) -> str:
    """A template of the answers; its ``_single`` twin where one Q-Map stands for the whole reward."""
    return str(words["answers"][key if len(decision.components) > 1 else f"{key}_single"])


def missing(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """A thing that is not there, and what is."""
    there, counts = (listing if question.by == "letter" else scene)(question, decision, words)
    return f"{words['answers']['missing'].format(thing=question.thing)} {there}", counts


def no_component(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """A property without a Q-Map of its own."""
    known = listed([phrase(name, words) for name in decision.components], words)
    return wording("no_component", decision, words).format(
        component=phrase(question.component or "", words), known=known
    ), []


def component_of(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The values of one component."""
    name = question.component or decision.components[0]
    said = [
        words["answers"]["value_of"].format(value=number(c.values[name]), object=called(c, decision, words))
        for c in question.about or (question.pool or [])[:_MOST_LISTED]
    ]
    key = "component_of" if name in words["meanings"] else "component_of_alone"
    meaning = words["meanings"].get(name, "")
    return words["answers"][key].format(component=phrase(name, words), values=listed(said, words), meaning=meaning), []


def meaning(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What a component stands for."""
    name = question.component or decision.components[0]
    key = "meaning" if name in words["meanings"] else "no_meaning"
    return words["answers"][key].format(component=phrase(name, words), meaning=words["meanings"].get(name, "")), []


def values(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """All values of things."""
    said = []
    for c in question.about or (question.pool or [])[:_MOST_FOUND]:
        values = listed([f"{phrase(name, words)} {number(c.values[name])}" for name in decision.components], words)
        named = {"object": called(c, decision, words), "values": values, "overall": number(c.overall)}
        said.append(sentence(wording("values", decision, words).format(**named)))
    return " ".join(said), []


def listing(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The candidates."""
    lines = [
        words["answers"]["listed"].format(label=c.label, object=the(c.object), overall=number(c.overall))
        for c in decision.candidates
    ]
    return wording("list", decision, words).format(candidates=listed(lines, words)), []


def scene(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What is in the scene, or which of a sort are, or what lies at a place."""
    places = Places(decision)
    asked = question.pool if question.kind == "scene" else None
    things = [c for c in (asked or places.things) if c.object_index is not None] or asked or []
    if asked is not None and not asked:
        return str(words["answers"]["none_there"]).format(things=question.said), []
    if not things:
        return listing(question, decision, words)
    names = list(dict.fromkeys(thing.object for thing in things))
    shown, computed = [], [float(len(things))]
    for name in names[:_MOST_LISTED]:
        here = [thing for thing in things if thing.object == name]
        said = so_many(name, len(here), words)
        if asked is not None and len(things) <= _MOST_LISTED:
            spots = [spot for thing in here if (spot := _spot(thing, decision, words))]
            said += f" ({'; '.join(spots)})" if spots else ""
        shown.append(said)
        computed.append(float(len(here)))
    if len(names) > _MOST_LISTED:
        shown.append(words["answers"]["others"])
    total = so_many(words["answers"]["an_object"], len(things), words)
    key = "scene" if len(names) > 1 else "scene_one"
    return words["answers"][key].format(total=total, things=listed(shown, words)), computed


def _spot(thing: Candidate, decision: Decision, words: Mapping[str, Any]) -> str:
    """A thing's letter and where it lies."""
    letter = words["own_choice"] if thing.label == SELECTED else thing.label if thing.label != thing.object else ""
    return ", ".join(part for part in (letter, where(thing, decision, words)) if part)


def called_where(thing: Candidate, decision: Decision, words: Mapping[str, Any]) -> str:
    """A thing and where it lies."""
    name, place = called(thing, decision, words), where(thing, decision, words)
    if thing.label == SELECTED:
        name = f"{name} ({words['own_choice']})"
    return name if not place or place in name else f"{name} {place}"


def counted_word(count: int, words: Mapping[str, Any]) -> str:
    """A number in words, where there is one for it."""
    return str(words["numbers"][count]) if count < len(words["numbers"]) else str(count)


def so_many(name: str, count: int, words: Mapping[str, Any]) -> str:
    """So many things of a name."""
    called = name if count == 1 else str(words["answers"]["plural"]).format(name=name)
    return str(words["answers"]["count"]).format(count=counted_word(count, words), name=called)


def who(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which object a letter marks, and what it is the best of."""
    meant, alternatives = question.about[0], decision.alternatives
    whose = (
        dict(zip((c.label for c in alternatives), decision.components, strict=False))
        if len(alternatives) == len(decision.components)
        else {}
    )
    text = values(question, decision, words)[0]
    if len(decision.components) == 1 or meant.label not in whose:
        return text, []
    best = words["answers"]["who"].format(
        label=meant.label, object=the(meant.object), component=phrase(whose[meant.label], words)
    )
    return f"{best} {text}", []


def of_number(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which of the decision's numbers one is."""
    asked, say = number(float(question.thing)), words["answers"]
    found: list[str] = []
    for c in (*decision.candidates, *(o for o in decision.objects if not is_listed(o, decision))):
        found += [
            say["number_value"].format(component=phrase(n, words), object=called(c, decision, words))
            for n in c.values
            if _is(c.values[n], asked)
        ]
        if len(c.values) > 1 and _is(c.overall, asked):
            found.append(say["number_overall"].format(object=called(c, decision, words)))
    others = [o for o in decision.others if not is_listed(o, decision)]
    pairs = [(decision[a], decision[b]) for a, b in decision.pairs] + [(decision.selected, other) for other in others]
    for first, second in pairs:
        names = {
            "first": first.label,
            "second": second.label if second in decision.candidates else called(second, decision, words),
        }
        delta = contrast.rdx(first.values, second.values)
        found += [
            say["number_difference"].format(component=phrase(n, words), **names) for n in delta if _is(delta[n], asked)
        ]
        if len(delta) > 1 and _is(sum(delta.values()), asked):
            found.append(say["number_difference"].format(component=say["overall"], **names))
        if first.label == SELECTED:
            turns = [phrase(n, words) for n, weight in contrast.flip_points(delta).items() if _is(weight, asked)]
            found += [
                say["number_turn"].format(component=name, other=called(second, decision, words)) for name in turns
            ]
    if len(decision.components) > 1 and (robust := decision.robustness()) and _is(robust[0], asked):
        found.append(say["number_distance"])
    if decision.error and _is(decision.error, asked):
        found.append(say["number_error"])
    if not found:
        return say["number_none"].format(number=asked), []
    return say["number"].format(number=asked, what=listed(found[:_MOST_FOUND], words)), []


def _is(value: float, printed: str) -> bool:
    return number(abs(value)) == printed
