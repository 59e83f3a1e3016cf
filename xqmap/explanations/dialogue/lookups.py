"""Answers that look something up in a decision: its values, things, places and numbers. The wording is the task's, as
in ``answers``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xqmap.explanations import contrast
from xqmap.explanations.candidate import SELECTED, Candidate, together
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.factors import NUMBERS
from xqmap.explanations.dialogue.questions import Question
from xqmap.explanations.views.sentences import listed, number, phrase, sentence, the

# An answer, and the numbers in it that were computed for it (values under other weights, counts).
Answer = tuple[str, list[float]]
# Objects that one answer lists at most, and how many it ranks.
_MOST_LISTED, _MOST_RANKED = 12, 4


def wording(key: str, decision: Decision, words: Mapping[str, Any]) -> str:
    """A template of the answers; its ``_single`` twin where one Q-Map stands for the whole reward."""
    return str(words["answers"][key if len(decision.components) > 1 else f"{key}_single"])


def missing(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """A thing that is not there, and what is."""
    there, counts = (listing if question.thing.startswith("candidate ") else scene)(question, decision, words)
    return f"{words['answers']['missing'].format(thing=question.thing)} {there}", counts


def no_component(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """A property without a Q-Map of its own."""
    known = listed([phrase(name, words) for name in decision.components])
    return wording("no_component", decision, words).format(
        component=phrase(question.component or "", words), known=known
    ), []


def component_of(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The values of one component."""
    name = question.component or decision.components[0]
    said = [f"{number(c.values[name])} for {called(c, decision)}" for c in question.about]
    key = "component_of" if name in words["meanings"] else "component_of_alone"
    meaning = words["meanings"].get(name, "")
    return words["answers"][key].format(component=phrase(name, words), values=listed(said), meaning=meaning), []


def meaning(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What a component stands for."""
    name = question.component or decision.components[0]
    key = "meaning" if name in words["meanings"] else "no_meaning"
    return words["answers"][key].format(component=phrase(name, words), meaning=words["meanings"].get(name, "")), []


def values(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """All values of things."""
    said = []
    for c in question.about:
        values = listed([f"{phrase(name, words)} {number(c.values[name])}" for name in decision.components])
        named = {"object": called(c, decision), "values": values, "overall": number(c.overall)}
        said.append(sentence(wording("values", decision, words).format(**named)))
    return " ".join(said), []


def where(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Where things lie."""
    said: list[str] = []
    computed: list[float] = []
    for c in question.about:
        if c.pixel is None:
            said.append(words["answers"]["no_place"].format(object=called(c, decision)))
            continue
        x, y, z = c.position or (0.0, 0.0, 0.0)
        key = "where" if c.position is not None else "where_pixel"
        named = {"row": c.pixel[0], "column": c.pixel[1], "x": number(x), "y": number(y), "z": number(z)}
        said.append(words["answers"][key].format(object=called(c, decision), **named))
        computed += [*c.pixel, x, y, z]
    return " ".join(map(sentence, said)), computed


def listing(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The candidates."""
    lines = [f"{c.label}, {the(c.object)} (overall value {number(c.overall)})" for c in decision.candidates]
    return wording("list", decision, words).format(candidates=listed(lines)), []


def scene(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What is in the scene."""
    things = [thing for thing in decision.objects if thing.object_index is not None]
    if not things or decision.selected.pixel is None:
        return listing(question, decision, words)
    counts: dict[str, int] = {}
    for thing in things:
        counts[thing.object] = counts.get(thing.object, 0) + 1
    shown = [
        f"{NUMBERS[n] if n < len(NUMBERS) else n} {name}{'s' if n > 1 else ''}"
        for name, n in list(counts.items())[:_MOST_LISTED]
    ]
    if len(counts) > _MOST_LISTED:
        shown.append("others")
    total = (
        f"{NUMBERS[len(things)] if len(things) < len(NUMBERS) else len(things)} object{'s' if len(things) > 1 else ''}"
    )
    return words["answers"]["scene"].format(total=total, things=listed(shown)), [
        float(len(things)),
        *map(float, counts.values()),
    ]


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


def most(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which things are worth most, or least, in a component or over all, each taken where it is worth most."""
    name = question.component

    def worth(candidate: Candidate) -> float:
        return candidate.overall if name is None else candidate.values[name]

    best: dict[tuple[str, int | None], Candidate] = {}
    for c in sorted([*decision.candidates, *decision.objects], key=worth, reverse=True):
        if question.thing in c.object.lower():
            best.setdefault((c.object, c.object_index), c)
    order = sorted(best.values(), key=worth, reverse=not question.lowest)[:_MOST_RANKED]
    first, *rest = [f"{called(c, decision)} with {number(worth(c))}" for c in order]
    template = words["answers"][("least" if question.lowest else "most") if rest else "only"]
    of = words["answers"]["overall"] if name is None else phrase(name, words)
    return template.format(of=of, first=first, rest=listed(rest) if rest else ""), []


def of_number(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which of the decision's numbers one is."""
    asked, say = number(float(question.thing)), words["answers"]
    found: list[str] = []
    for c in (*decision.candidates, *(o for o in decision.objects if not is_listed(o, decision))):
        found += [
            say["number_value"].format(component=phrase(n, words), object=called(c, decision))
            for n in c.values
            if _is(c.values[n], asked)
        ]
        if len(c.values) > 1 and _is(c.overall, asked):
            found.append(say["number_overall"].format(object=called(c, decision)))
    others = [o for o in decision.others if not is_listed(o, decision)]
    pairs = [(decision[a], decision[b]) for a, b in decision.pairs] + [(decision.selected, other) for other in others]
    for first, second in pairs:
        names = {
            "first": first.label,
            "second": second.label if second in decision.candidates else called(second, decision),
        }
        delta = contrast.rdx(first.values, second.values)
        found += [
            say["number_difference"].format(component=phrase(n, words), **names) for n in delta if _is(delta[n], asked)
        ]
        if len(delta) > 1 and _is(sum(delta.values()), asked):
            found.append(say["number_difference"].format(component=say["overall"], **names))
        if first.label == SELECTED:
            turns = [phrase(n, words) for n, weight in contrast.flip_points(delta).items() if _is(weight, asked)]
            found += [say["number_turn"].format(component=name, other=called(second, decision)) for name in turns]
    if len(decision.components) > 1 and (robust := decision.robustness()) and _is(robust[0], asked):
        found.append(say["number_distance"])
    if decision.error and _is(decision.error, asked):
        found.append(say["number_error"])
    if not found:
        return say["number_none"].format(number=asked), []
    return say["number"].format(number=asked, what=listed(found[:_MOST_RANKED])), []


def _is(value: float, printed: str) -> bool:
    return number(abs(value)) == printed


def is_listed(thing: Candidate, decision: Decision) -> bool:
    """Whether a thing is one of the candidates."""
    return any(together(thing, candidate) for candidate in decision.candidates)


def called(candidate: Candidate, decision: Decision) -> str:
    """A candidate in an answer: "the ground (A)"; one that bears the chosen one's name, but is not it, is "another"
    one.
    """
    chosen = decision.selected
    if candidate.label == SELECTED:
        return the(candidate.object)
    name = the(candidate.object)
    if candidate.object == chosen.object and not together(candidate, chosen):
        name = (
            f"another {candidate.object}"
            if candidate.object_index is not None
            else f"another spot of {the(candidate.object)}"
        )
    here = [
        c for c in decision.alternatives if (c.object, c.object_index) == (candidate.object, candidate.object_index)
    ]
    if candidate.label == candidate.object and any(c.pixel != candidate.pixel for c in here):
        # A candidate lies on it too, elsewhere.
        return f"{name} at its best spot"
    return name if candidate.label in ("", candidate.object) else f"{name} ({candidate.label})"
