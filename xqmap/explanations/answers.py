"""Answers from the numbers alone: no network, no key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from xqmap.explanations import contrast, sentences
from xqmap.explanations.decision import SELECTED, Candidate, Decision
from xqmap.explanations.questions import Question
from xqmap.explanations.sentences import listed, number, signed

HELP = (
    "I can say why I chose this one, why not another (name a label like B, or an object), which component matters most, what a "
    "component's value is, how sure I am, what if a component counted more or less, what it would take to change my choice, which "
    "candidates there were, and what a Q-value is here."
)


def answer(question: Question, decision: Decision, words: Mapping[str, Any]) -> tuple[str, list[float]]:
    """Answers a question that was understood.

    Returns:
        The answer, and the numbers in it that were computed for it (values under other weights).
    """
    kind = question.kind
    if kind == "help":
        return HELP, []
    if kind == "unknown":
        return f"I did not understand that. {HELP}", []
    if kind == "missing":
        return f"I see no {question.component} in this scene. {answer(Question('list'), decision, words)[0]}", []
    if kind == "shallow":
        return sentences.shallow(decision, words), []
    if kind == "contrastive":
        return " ".join(_contrast(decision, other, words) for other in question.about), []
    if kind == "component":
        return _component(decision, question.about, words), []
    if kind == "component_of" and question.component:
        return _component_of(decision, question.about, question.component, words), []
    if kind == "list":
        lines = [f"{c.label}: the {c.object} (overall {number(c.overall)})" for c in decision.candidates]
        return f"I looked at {listed(lines)}. Each letter is the best action for one component alone.", []
    if kind == "sure":
        return _sure(decision, question.about or decision.alternatives), []
    if kind == "robust":
        turns = [_flip(decision, other, words) for other in question.about or decision.alternatives]
        return " ".join([sentences.robustness(decision), *(turn for turn in turns if turn)]), []
    if kind == "what_if" and question.component and question.weight is not None:
        return _what_if(decision, question.component, question.weight, words)
    return _q_value(decision, words), []


def _contrast(decision: Decision, other: Candidate, words: Mapping[str, Any]) -> str:
    if other.label == SELECTED:
        return sentences.shallow(decision, words)
    return sentences.contrastive(_with(decision, other), SELECTED, other.label, words)


def _with(decision: Decision, other: Candidate) -> Decision:
    """The decision with one of the scene's objects as a candidate, so that it can be contrasted."""
    if any(candidate.label == other.label for candidate in decision.candidates):
        return decision
    known = [*decision.candidates, other]
    return Decision(decision.task, decision.components, known, objects=decision.objects, noise=decision.noise, maps=decision.maps)


def _component(decision: Decision, about: list[Candidate], words: Mapping[str, Any]) -> str:
    if about:
        other = about[0]
        delta = contrast.rdx(decision.selected.values, other.values)
        best = max(delta, key=lambda name: delta[name])
        return f"Against the {other.object}, {_called(best, words)} makes the largest difference for my choice ({signed(delta[best])})."
    best = decision.shallow
    values = listed([f"{_called(name, words)} {number(decision.selected.values[name])}" for name in decision.components])
    return f"{_called(best, words).capitalize()} contributes most to the {decision.selected.object}: {values}."


def _component_of(decision: Decision, about: list[Candidate], component: str, words: Mapping[str, Any]) -> str:
    said = [f"for the {c.object} it is {number(c.values[component])}" for c in about]
    return f"The value of {_called(component, words)}: {listed(said)}."


def _sure(decision: Decision, others: list[Candidate]) -> str:
    others = [other for other in others if not _with(decision, other).same(SELECTED, other.label)]
    if not others:
        return "All candidates lie on the object I chose, so every component agrees with the choice."
    error = math.hypot(*(decision.noise.get(name, 0.0) for name in decision.components))
    said = []
    for other in others:
        gap = abs(decision.selected.overall - other.overall)
        verdict = ""
        if error > 0:
            verdict = ", more than the typical error of my values" if gap > error else ", within the typical error of my values: a toss-up"
        said.append(f"the {other.object} is {number(gap)} behind{verdict}")
    known = f" That error is {number(error)}." if error > 0 else " How far my values are typically off is not known for this decision."
    return f"Measured in overall value, {listed(said)}.{known}"


def _flip(decision: Decision, other: Candidate, words: Mapping[str, Any]) -> str:
    if other.label == SELECTED or _with(decision, other).same(SELECTED, other.label):
        return ""
    found = contrast.nearest_flip(contrast.rdx(decision.selected.values, other.values))
    if found is None:
        return f"No change in the weight of a single component would make the {other.object} as good."
    return f"The {other.object} would be just as good if {_called(found[0], words)} counted {number(found[1])} times as much."


def _what_if(decision: Decision, component: str, weight: float, words: Mapping[str, Any]) -> tuple[str, list[float]]:
    """The choice of the same maps with one component's weight changed: one argmax more, no learning."""
    factors = {name: weight if name == component else 1.0 for name in decision.components}
    pool = [(c.object, c.object_index, c.values) for c in decision.candidates]
    pool += [(o.object, o.object_index, o.values) for o in decision.objects]
    totals = [sum(factors[name] * values[name] for name in decision.components) for _, _, values in pool]
    best = max(range(len(pool)), key=lambda i: totals[i])
    name, index, _ = pool[best]
    kept = totals[0] >= totals[best] - 1e-9 or (index is not None and index == decision.selected.object_index)
    where = "the actions I know of"
    if decision.maps is not None:
        # The best cell of all may lie on the background, which the pool holds only through the candidates.
        total = (decision.maps * np.array([factors[n] for n in decision.components])[:, None, None]).sum(0)
        where = "all actions of these maps"
        if float(np.nanmax(total)) > totals[best] + 1e-9:
            totals[best] = float(np.nanmax(total))
            name, kept = "a spot that is none of the candidates", False
    factor = "did not count" if weight == 0 else f"counted {number(weight)} times as much"
    if kept:
        text = f"If {_called(component, words)} {factor}, I would still choose the {decision.selected.object}"
    else:
        text = f"If {_called(component, words)} {factor}, I would choose {name if name.startswith('a ') else 'the ' + name}"
    text += f" (overall value {number(totals[best] if not kept else totals[0])}), judged over {where} with everything else as it is."
    return text, [totals[best], totals[0], weight]


def _q_value(decision: Decision, words: Mapping[str, Any]) -> str:
    names = listed([_called(name, words) for name in decision.components])
    return (
        "A Q-value is how much reward I expect from an action, now and later. I keep one Q-Map per component, "
        f"here for {names}: each gives every pixel that component's expected reward. I take the pixel where their sum is highest; "
        f"for the {decision.selected.object} that sum is {number(decision.selected.overall)}."
    )


def _called(component: str, words: Mapping[str, Any]) -> str:
    return str(words["components"].get(component, component))
