"""Answers from the numbers alone: no network, no key. The wording is the task's (``answers`` in
``conf/explain/wording``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from xqmap.explanations import contrast
from xqmap.explanations.candidate import together
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue import facts, lookups, rankings, suppositions
from xqmap.explanations.dialogue.lookups import Answer, wording
from xqmap.explanations.dialogue.mentions import is_own
from xqmap.explanations.dialogue.naming import called, is_listed, placed
from xqmap.explanations.dialogue.question import Question
from xqmap.explanations.views import sentences
from xqmap.explanations.views.words import listed, number, phrase, sentence, signed, the

# A choice by no more than so many typical errors of its values is narrow.
_NARROW = 3


def answer(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Answers a question that was understood."""
    text, computed = _ANSWERS.get(question.kind, _unknown)(question, decision, words)
    if question.property:
        text += f" {lookups.no_component(Question('', component=question.property), decision, words)[0]}"
    if question.strange and question.kind not in ("unknown", "missing", "misplaced"):
        passed = words["answers"]["strange"].format(words=listed([f'"{word}"' for word in question.strange], words))
        text = f"{passed} {sentence(text)}"
    return sentence(text), computed


def _plain(key: str) -> Callable[[Question, Decision, Mapping[str, Any]], Answer]:
    def say(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
        return words["answers"][key], []

    return say


def _unknown(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return wording("unknown", decision, words).format(component=phrase(decision.shallow, words)), []


def _self(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    known = listed([phrase(name, words) for name in decision.components], words)
    return wording("self", decision, words).format(setting=words["setting"], components=known), []


def _shallow(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return sentences.shallow(decision, words), []


def _contrastive(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if not question.about and question.pool:
        others = [c for c in question.pool if not is_own(c)]
        return facts.best_of(others, decision, words) if others else facts.presupposed(question, decision, words)
    if not question.about:
        return (
            facts.best_of(decision.others[:1], decision, words) if decision.others else (words["answers"]["alone"], [])
        )
    if question.about == [decision.selected]:
        same = words["answers"]["same_place"].format(
            this=words["answers"]["this"], object=the(decision.selected.object)
        )
        return f"{same} {sentences.shallow(decision, words)}", []
    said = [
        sentences.contrastive(decision, decision.selected, placed(other, decision, words), words)
        for other in question.about
    ]
    return " ".join(said), []


def _because(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What is behind a difference that was told already: the property that makes most of it, in both."""
    if len(decision.components) == 1:
        return _contrastive(question, decision, words)
    other, chosen = question.about[0], decision.selected
    delta = contrast.rdx(chosen.values, other.values)
    name = max(delta, key=lambda n: abs(delta[n]))
    text = words["answers"]["because"].format(
        component=phrase(name, words),
        own=called(chosen, decision, words),
        value=number(chosen.values[name]),
        other=called(other, decision, words),
        other_value=number(other.values[name]),
    )
    meaning = words["meanings"].get(name, "")
    more = words["answers"]["meaning"].format(component=phrase(name, words), meaning=meaning) if meaning else ""
    return f"{sentence(text)} {sentence(more)}".strip(), []


def _pair(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    first, second = (placed(c, decision, words) for c in question.about[:2])
    return sentences.contrastive(decision, first, second, words), []


def _runner_up(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What would be chosen without the things that are named, or without the choice."""
    if question.about and not any(map(is_own, question.about)):
        return words["answers"]["still"].format(object=the(decision.selected.object)), []
    left = [c for c in decision.others if not any(together(c, gone) for gone in question.about)]
    if not left:
        return words["answers"]["alone"], []
    best = left[0]
    text = words["answers"]["runner_up"].format(other=called(best, decision, words), overall=number(best.overall))
    told = sentences.contrastive(decision, decision.selected, placed(best, decision, words), words)
    return f"{sentence(text)} {told}", []


def _component(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if len(decision.components) == 1:
        return words["answers"]["one_component"].format(
            object=the(decision.selected.object), overall=number(decision.selected.overall)
        ), []
    chosen = decision.selected
    if question.about:
        said = []
        for other in question.about:
            delta = contrast.rdx(chosen.values, other.values)
            best = max(delta, key=lambda name: delta[name])
            key = "component_against" if delta[best] > 0 else "component_none_against"
            named = {
                "other": called(other, decision, words),
                "component": phrase(best, words),
                "value": signed(delta[best]),
            }
            said.append(sentence(words["answers"][key].format(**named)))
        return " ".join(said), []
    values = listed([f"{phrase(name, words)} {number(chosen.values[name])}" for name in decision.components], words)
    named = {"component": phrase(decision.shallow, words), "object": the(chosen.object), "values": values}
    return words["answers"]["component"].format(**named), []


def _sure(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    chosen, error = decision.selected, decision.error
    # Beside the candidates, the best other object counts: it may be closer.
    others = question.about or [*decision.alternatives, *(o for o in decision.others[:1] if not is_listed(o, decision))]
    others = sentences.apart([other for other in others if not together(chosen, other)])
    if not others and question.about:
        return sentence(
            words["answers"]["same_place"].format(
                this=sentences.referred(question.about[0], words), object=the(chosen.object)
            )
        ), []
    if not others:
        return words["answers"]["alone"], []
    gaps = [chosen.overall - other.overall for other in others]
    behind = listed(
        [
            words["answers"]["behind" if g >= 0 else "ahead"].format(
                object=called(o, decision, words), gap=number(abs(g))
            )
            for o, g in zip(others, gaps, strict=True)
        ],
        words,
    )
    text = sentence(words["answers"]["sure"].format(behind=behind))
    if error == 0:
        return f"{text} {words['answers']['sure_unknown']}", []
    open_ = [other for other, gap in zip(others, gaps, strict=True) if abs(gap) <= error]
    key = "sure_clear" if not open_ else "sure_open" if len(open_) == len(others) else "sure_mixed"
    narrow = [other for other, gap in zip(others, gaps, strict=True) if abs(gap) <= _NARROW * error]
    if narrow and not open_:
        key, open_ = "sure_narrow", narrow
    against = listed([called(other, decision, words) for other in open_], words) if open_ else ""
    return f"{text} {words['answers'][key].format(error=number(error), against=against)}", []


def _chance(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    text, computed = _sure(question, decision, words)
    return f"{words['answers']['chance']} {text}", computed


def _q_value(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    names = listed([phrase(name, words) for name in decision.components], words)
    chosen = decision.selected
    return wording("q_value", decision, words).format(
        components=names, object=the(chosen.object), overall=number(chosen.overall)
    ), []


def _safe(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What is known about whether it will go well: the values, and that no property is of that kind."""
    meant = question.about[0] if question.about else decision.selected
    values = listed([f"{phrase(n, words)} {number(meant.values[n])}" for n in decision.components], words)
    known = [
        sentence(words["answers"]["meaning"].format(component=phrase(n, words), meaning=words["meanings"][n]))
        for n in decision.components
        if n in words["meanings"]
    ]
    told = words["answers"]["safe"].format(object=called(meant, decision, words), values=values)
    return " ".join([told, *known]), []


def _show(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What the picture shows; the conversation adds where it lies."""
    return words["answers"]["show" if decision.maps is not None else "show_values"], []


_ANSWERS: dict[str, Callable[[Question, Decision, Mapping[str, Any]], Answer]] = {
    "help": _plain("help"),
    "rdx": _plain("rdx"),
    "thanks": _plain("thanks"),
    "scene_if": lambda question, decision, words: (wording("scene_if", decision, words), []),
    "self": _self,
    "missing": lookups.missing,
    "misplaced": facts.misplaced,
    "which_one": facts.which_one,
    "no_component": lookups.no_component,
    "shallow": _shallow,
    "contrastive": _contrastive,
    "because": _because,
    "presupposed": facts.presupposed,
    "pair": _pair,
    "runner_up": _runner_up,
    "component": _component,
    "component_of": lookups.component_of,
    "difference": rankings.difference,
    "meaning": lookups.meaning,
    "values": lookups.values,
    "where": facts.place,
    "distance": facts.distance,
    "height": facts.height,
    "size": facts.size,
    "identity": facts.identity,
    "disagree": facts.disagree,
    "list": lookups.listing,
    "scene": lookups.scene,
    "who": lookups.who,
    "most": rankings.most,
    "rank": rankings.rank,
    "which": rankings.which,
    "number": lookups.of_number,
    "above": suppositions.above,
    "sure": _sure,
    "safe": _safe,
    "chance": _chance,
    "robust": suppositions.robust,
    "turn": suppositions.turn,
    "what_if": suppositions.what_if,
    "next": suppositions.afterwards,
    "show": _show,
    "q_value": _q_value,
}

# How a question can be taken.
KINDS = (*_ANSWERS, "unknown")
