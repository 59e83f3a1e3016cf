"""Answers that put things in order, count them or hold a component of two against each other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.lookups import Answer, counted_word
from xqmap.explanations.dialogue.naming import called
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.dialogue.question import Question
from xqmap.explanations.views.words import listed, number, phrase, sentence, signed

# Things that one answer ranks in full, and how many it names where only the first is asked for.
_MOST_RANKED, _MOST_NAMED = 12, 4
# A reward for what is so or not is expected above this where it is.
_HALF = 0.5


def most(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which things are worth most, or least, in a component or over all; or stand highest, or are largest."""
    order, say = _order(question, decision), words["answers"]
    if not order:
        return say["none_there"].format(things=question.said), []
    lowest = question.most is False
    shown = (order[::-1] if lowest else order)[:_MOST_NAMED]
    worth = _worth(question, decision)
    first, *rest = [f"{called(c, decision, words)} {say['with'].format(value=number(worth(c)))}" for c in shown]
    template = say[("least" if lowest else "most") if rest else "only"]
    return template.format(of=_of(question, words), first=first, rest=listed(rest, words) if rest else ""), [
        worth(c) for c in shown
    ]


def rank(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """All things in their order."""
    order, say, worth = _order(question, decision), words["answers"], _worth(question, decision)
    if not order:
        return say["none_there"].format(things=question.said), []
    shown = [f"{called(c, decision, words)} ({number(worth(c))})" for c in order[:_MOST_RANKED]]
    rest = len(order) - len(shown)
    more = [say["more"].format(count=rest)] if rest else []
    return say["ranked"].format(of=_of(question, words), things=listed([*shown, *more], words)), [
        float(rest),
        *map(worth, order),
    ]


def which(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Which things have a property, or have it not, and how many."""
    name = question.component or decision.components[0]
    if name in words["graded"]:
        return rank(question, decision, words)
    order, say = _order(question, decision), words["answers"]
    found = [c for c in order if (c.values[name] > _HALF) != question.denied]
    component = phrase(name, words)
    side = say["below" if question.denied else "over"]
    counted = {
        "count": counted_word(len(found), words),
        "all": counted_word(len(order), words),
        "component": component,
        "side": side,
    }
    if not found:
        return say["which_none"].format(**counted), [len(order)]
    shown = [f"{called(c, decision, words)} ({number(c.values[name])})" for c in found[:_MOST_RANKED]]
    more = [say["more"].format(count=len(found) - len(shown))] if len(found) > len(shown) else []
    close = [c for c in found if abs(c.values[name] - _HALF) <= decision.noise.get(name, 0.0)]
    doubt = (
        f" {say['which_close'].format(things=listed([called(c, decision, words) for c in close], words))}"
        if close
        else ""
    )
    return say["which"].format(**counted, things=listed([*shown, *more], words)) + doubt, [
        _HALF,
        len(found),
        len(order),
    ]


def difference(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """One component of two things."""
    name = question.component or decision.shallow
    about = [*question.about] if len(question.about) > 1 else [decision.selected, *question.about]
    about += decision.others[:1] if len(about) < 2 or about[0] is about[1] else []
    first, second = about[0], about[-1]
    gap = first.values[name] - second.values[name]
    error = decision.noise.get(name, 0.0)
    key = "difference_open" if abs(gap) <= error else "difference"
    return sentence(
        words["answers"][key].format(
            component=phrase(name, words),
            first=called(first, decision, words),
            second=called(second, decision, words),
            one=number(first.values[name]),
            two=number(second.values[name]),
            gap=signed(gap),
            error=number(error),
        )
    ), [gap]


def _worth(question: Question, decision: Decision) -> Callable[[Candidate], float]:
    name, places = question.component, Places(decision)
    if question.by == "height":
        return lambda c: places.height(c) or 0.0
    if question.by == "size":
        return lambda c: places.area(c) or 0.0
    return lambda c: c.overall if name is None else c.values[name]


def _order(question: Question, decision: Decision) -> list[Candidate]:
    """The things that are asked about, each where it is worth most, the best first."""
    worth, places = _worth(question, decision), Places(decision)
    everything = places.objects if question.by else places.things
    things = everything if question.pool is None else question.pool
    best: list[Candidate] = []
    for thing in things:
        here = [c for c in (*decision.candidates, *decision.objects) if _same(c, thing)]
        best.append(max([thing, *here], key=worth))
    return sorted(best, key=worth, reverse=True)


def _same(first: Candidate, second: Candidate) -> bool:
    return (first.object, first.object_index) == (second.object, second.object_index)


def _of(question: Question, words: Mapping[str, Any]) -> str:
    if question.by:
        return str(words["answers"][f"by_{question.by}"])
    return words["answers"]["overall"] if question.component is None else phrase(question.component, words)
