"""Answers from the numbers alone: no network, no key. The wording is the task's (``answers`` in
``conf/explain/wording``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from xqmap.explanations import contrast
from xqmap.explanations.candidate import Candidate, together
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue import lookups
from xqmap.explanations.dialogue.lookups import Answer, called, is_listed, wording
from xqmap.explanations.dialogue.questions import Question
from xqmap.explanations.views import sentences
from xqmap.explanations.views.sentences import counted, listed, number, phrase, sentence, signed, the

# A choice by no more than so many typical errors of its values is narrow.
_NARROW = 3


def answer(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Answers a question that was understood."""
    text, computed = _ANSWERS.get(question.kind, _unknown)(question, decision, words)
    return sentence(text), computed


def _plain(key: str) -> Callable[[Question, Decision, Mapping[str, Any]], Answer]:
    def say(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
        return words["answers"][key], []

    return say


def _unknown(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return wording("unknown", decision, words).format(component=phrase(decision.shallow, words)), []


def _self(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    known = listed([phrase(name, words) for name in decision.components])
    return wording("self", decision, words).format(setting=words["setting"], components=known), []


def _shallow(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return sentences.shallow(decision, words), []


def _contrastive(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if not question.about:
        return words["answers"]["alone"], []
    if question.about == [decision.selected]:
        same = words["answers"]["same_place"].format(
            this=words["answers"]["this"], object=the(decision.selected.object)
        )
        return f"{same} {sentences.shallow(decision, words)}", []
    said = [sentences.contrastive(decision, decision.selected, other, words) for other in question.about]
    return " ".join(said), []


def _pair(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return sentences.contrastive(decision, question.about[0], question.about[1], words), []


def _runner_up(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if not decision.others:
        return words["answers"]["alone"], []
    best = decision.others[0]
    text = words["answers"]["runner_up"].format(other=called(best, decision), overall=number(best.overall))
    return f"{sentence(text)} {sentences.contrastive(decision, decision.selected, best, words)}", []


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
            named = {"other": called(other, decision), "component": phrase(best, words), "value": signed(delta[best])}
            said.append(sentence(words["answers"][key].format(**named)))
        return " ".join(said), []
    values = listed([f"{phrase(name, words)} {number(chosen.values[name])}" for name in decision.components])
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
            f"{called(o, decision)} is {number(abs(g))} {'behind' if g >= 0 else 'ahead'}"
            for o, g in zip(others, gaps, strict=True)
        ]
    )
    text = sentence(words["answers"]["sure"].format(behind=behind))
    if error == 0:
        return f"{text} {words['answers']['sure_unknown']}", []
    open_ = [other for other, gap in zip(others, gaps, strict=True) if abs(gap) <= error]
    key = "sure_clear" if not open_ else "sure_open" if len(open_) == len(others) else "sure_mixed"
    narrow = [other for other, gap in zip(others, gaps, strict=True) if abs(gap) <= _NARROW * error]
    if narrow and not open_:
        key, open_ = "sure_narrow", narrow
    against = listed([called(other, decision) for other in open_]) if open_ else ""
    return f"{text} {words['answers'][key].format(error=number(error), against=against)}", []


def _chance(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    text, computed = _sure(question, decision, words)
    return f"{words['answers']['chance']} {text}", computed


def _robust(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    said = [sentences.robustness(decision, words)]
    if len(decision.components) > 1:
        others = question.about or decision.alternatives
        for other in [c for c in others if not together(c, decision.selected)]:
            delta = contrast.rdx(decision.selected.values, other.values)
            said.append(sentence(sentences.turn(delta, called(other, decision), words)))
    return " ".join(said), []


def _what_if(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The choice of the same maps with other weights: one argmax more, no learning."""
    if min(question.factors.values()) < 0:
        return words["answers"]["what_if_negative"], []
    factors = {name: question.factors.get(name, 1.0) for name in decision.components}
    best, chosen = decision.best_under(factors), decision.selected

    def worth(candidate: Candidate) -> float:
        return sum(factors[name] * candidate.values[name] for name in decision.components)

    changes = [
        f"{phrase(name, words)} {'counted as much as now' if f == 1 else counted(f)}"
        for name, f in question.factors.items()
    ]
    kept = together(best, chosen) or worth(chosen) >= worth(best) - 1e-9
    named = {
        "changes": listed(changes),
        "object": the(chosen.object),
        "overall": number(worth(best)),
        "kept": number(worth(chosen)),
    }
    if kept:
        key = "what_if_kept"
    elif best.object == chosen.object:
        key = "what_if_elsewhere" if best.object_index is None else "what_if_another"
    else:
        key = "what_if_turned"
    named |= {"other": called(best, decision) if key == "what_if_turned" else best.object}
    said = f"{words['answers'][key].format(**named)} {words['answers']['what_if_note']}"
    return sentence(said), [worth(best), worth(chosen), *question.factors.values()]


def _q_value(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    names = listed([phrase(name, words) for name in decision.components])
    chosen = decision.selected
    return wording("q_value", decision, words).format(
        components=names, object=the(chosen.object), overall=number(chosen.overall)
    ), []


_ANSWERS: dict[str, Callable[[Question, Decision, Mapping[str, Any]], Answer]] = {
    "help": _plain("help"),
    "rdx": _plain("rdx"),
    "thanks": _plain("thanks"),
    "scene_if": lambda question, decision, words: (wording("scene_if", decision, words), []),
    "self": _self,
    "missing": lookups.missing,
    "no_component": lookups.no_component,
    "shallow": _shallow,
    "contrastive": _contrastive,
    "pair": _pair,
    "runner_up": _runner_up,
    "component": _component,
    "component_of": lookups.component_of,
    "meaning": lookups.meaning,
    "values": lookups.values,
    "where": lookups.where,
    "list": lookups.listing,
    "scene": lookups.scene,
    "who": lookups.who,
    "most": lookups.most,
    "number": lookups.of_number,
    "sure": _sure,
    "chance": _chance,
    "robust": _robust,
    "what_if": _what_if,
    "q_value": _q_value,
}

# How a question can be taken.
KINDS = (*_ANSWERS, "unknown")
