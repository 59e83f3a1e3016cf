"""Answers about what is not so: other weights, another choice, and what would come afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xqmap.explanations import contrast
from xqmap.explanations.candidate import Candidate, together
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.lookups import Answer, wording
from xqmap.explanations.dialogue.naming import called, placed
from xqmap.explanations.dialogue.question import Question
from xqmap.explanations.views import future, sentences
from xqmap.explanations.views.words import counted, listed, number, phrase, sentence, the


def robust(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What it would take to turn the choice, to anything or to a certain thing."""
    said = [] if question.about else [sentences.robustness(decision, words)]
    if len(decision.components) > 1:
        others = question.about or decision.alternatives
        for other in [c for c in others if not together(c, decision.selected)]:
            delta = contrast.rdx(decision.selected.values, other.values)
            said.append(sentence(sentences.turn(delta, called(other, decision, words), words)))
    return " ".join(said), []


def what_if(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The choice of the same maps with other weights: one argmax more, no learning."""
    if min(question.factors.values()) < 0:
        return words["answers"]["what_if_negative"], []
    factors = {name: question.factors.get(name, 1.0) for name in decision.components}
    best, chosen = decision.best_under(factors), decision.selected

    def worth(candidate: Candidate) -> float:
        return sum(factors[name] * candidate.values[name] for name in decision.components)

    changes = [
        f"{phrase(name, words)} {words['counted']['same'] if f == 1 else counted(f, words)}"
        for name, f in question.factors.items()
    ]
    kept = together(best, chosen) or worth(chosen) >= worth(best) - 1e-9
    named = {
        "changes": listed(changes, words),
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
    named |= {"other": called(best, decision, words) if key == "what_if_turned" else best.object}
    said = f"{words['answers'][key].format(**named)} {words['answers']['what_if_note']}"
    return sentence(said), [worth(best), worth(chosen), *question.factors.values()]


def turn(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """At which weight of a component, the others as they are, another thing would be chosen, or a certain one."""
    say = words["answers"]
    if len(decision.components) == 1:
        return words["robust_single"], []
    said, found = [], []
    for name in [question.component] if question.component else decision.components:
        if question.about:
            for other in question.about:
                weight = contrast.flip_points(contrast.rdx(decision.selected.values, other.values)).get(name)
                key = "turn_never" if weight is None else "turn_to"
                named = {"component": phrase(name, words), "other": called(other, decision, words)}
                said.append(say[key].format(**named, counted=counted(weight or 0.0, words)))
                found += [weight] if weight is not None else []
            continue
        points = turning_points(decision, name)
        for weight, other in points:
            key = "turn_below" if weight < 1 else "turn_above"
            named = {"component": phrase(name, words), "other": called(other, decision, words)}
            said.append(say[key].format(**named, weight=number(weight)))
            found.append(weight)
        if not points:
            said.append(say["turn_none"].format(component=phrase(name, words)))
    return " ".join(map(sentence, said)), found


def turning_points(decision: Decision, name: str) -> list[tuple[float, Candidate]]:
    """The weights of a component, the next below 1 and the next above, at which something else is chosen, and what.

    With maps it is looked for over all cells that are not on the chosen thing, else over the other things.
    """
    chosen = decision.selected
    if decision.maps is None or decision.scene is None:
        others = decision.others
        gaps = np.array([chosen.overall - other.overall for other in others])
        deltas = np.array([chosen.values[name] - other.values[name] for other in others])
    else:
        own = -1 if chosen.object_index is None else chosen.object_index
        inside = decision.scene.cells == own
        deltas = chosen.values[name] - decision.maps[decision.components.index(name)]
        gaps = chosen.overall - decision.maps.sum(0)
        gaps = np.where(inside | np.isnan(gaps), np.nan, gaps)
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = np.where(np.isfinite(gaps) & (deltas != 0), 1 - gaps / deltas, np.nan)
    weights = np.where((weights >= 0) & (gaps >= 0), weights, np.nan)
    found = []
    for side in (np.where(weights < 1, weights, -np.inf), np.where(weights > 1, -weights, -np.inf)):
        side = np.nan_to_num(side, nan=-np.inf)
        if side.size and np.isfinite(side.max()):
            at = np.unravel_index(int(side.argmax()), side.shape)
            where = (int(at[0]), int(at[1])) if decision.maps is not None and len(at) == 2 else None
            other = decision.at(where, "") if where else others[int(at[0])]
            found.append((float(weights[at]), other))
    return found


def above(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Why a value can be more than any reward."""
    cells = 0 if decision.maps is None else int(np.isfinite(decision.maps[0]).sum())
    say = words["answers"]
    over = [f"{phrase(n, words)} {number(value)}" for n, value in decision.selected.values.items() if value > 1]
    shown = say["above_here"].format(values=listed(over, words)) if over else say["above_none"]
    error = say["above_error"].format(error=number(decision.error)) if decision.error else ""
    luck = say["above_luck"].format(cells=cells) if cells else ""
    return " ".join(part for part in (say["above"], shown, error, luck) if part), [float(cells)]


def afterwards(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """What would follow the choice, or another one."""
    meant = question.about[0] if question.about else decision.selected
    names = {"object": called(meant, decision, words), "overall": number(meant.overall)}
    if meant.parts is None:
        return wording("afterwards", decision, words).format(**names), []
    if not decision.foresees:
        return words["answers"]["afterwards_none"].format(**names), []
    meant = placed(meant, decision, words)
    said = [future.expected(decision, meant, words)]
    if not together(meant, decision.selected):
        said.append(sentences.contrastive(decision, decision.selected, meant, words))
    return " ".join(said), []
