"""Answers from the numbers alone: no network, no key. The wording is the task's (``answers`` in ``conf/explain/wording``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from xqmap.explanations import contrast, sentences
from xqmap.explanations.decision import SELECTED, Candidate, Decision, together
from xqmap.explanations.questions import NUMBERS, Question
from xqmap.explanations.sentences import counted, listed, number, phrase, sentence, signed, the

# An answer, and the numbers in it that were computed for it (values under other weights, counts).
Answer = tuple[str, list[float]]
# Objects that one answer lists at most.
_MOST_LISTED = 12


def answer(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """Answers a question that was understood."""
    text, computed = _ANSWERS.get(question.kind, _unknown)(question, decision, words)
    return sentence(text), computed


def _plain(key: str) -> Callable[[Question, Decision, Mapping[str, Any]], Answer]:
    def say(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
        return words["answers"][key], []

    return say


def _unknown(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return f"{words['answers']['unknown']} {words['answers']['help']}", []


def _missing(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    listing, counts = _scene(question, decision, words)
    return f"{words['answers']['missing'].format(thing=question.thing)} {listing}", counts


def _no_component(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    known = listed([phrase(name, words) for name in decision.components])
    return words["answers"]["no_component"].format(component=phrase(question.component or "", words), known=known), []


def _shallow(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return sentences.shallow(decision, words), []


def _contrastive(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if not question.about:
        return words["answers"]["alone"], []
    said = [sentences.contrastive(decision, decision.selected, other, words) for other in question.about]
    return " ".join(said), []


def _pair(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return sentences.contrastive(decision, question.about[0], question.about[1], words), []


def _runner_up(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if not decision.others:
        return words["answers"]["alone"], []
    best = decision.others[0]
    text = words["answers"]["runner_up"].format(other=_named(best, decision), overall=number(best.overall))
    return f"{sentence(text)} {sentences.contrastive(decision, decision.selected, best, words)}", []


def _component(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    if len(decision.components) == 1:
        return words["answers"]["one_component"].format(object=the(decision.selected.object), overall=number(decision.selected.overall)), []
    chosen = decision.selected
    if question.about:
        said = []
        for other in question.about:
            delta = contrast.rdx(chosen.values, other.values)
            best = max(delta, key=lambda name: delta[name])
            key = "component_against" if delta[best] > 0 else "component_none_against"
            named = {"other": _named(other, decision), "component": phrase(best, words), "value": signed(delta[best])}
            said.append(sentence(words["answers"][key].format(**named)))
        return " ".join(said), []
    values = listed([f"{phrase(name, words)} {number(chosen.values[name])}" for name in decision.components])
    named = {"component": phrase(decision.shallow, words), "object": the(chosen.object), "values": values}
    return words["answers"]["component"].format(**named), []


def _component_of(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    name = question.component or decision.components[0]
    said = [f"{number(c.values[name])} for {_named(c, decision)}" for c in question.about]
    key = "component_of" if name in words["meanings"] else "component_of_alone"
    meaning = words["meanings"].get(name, "")
    return words["answers"][key].format(component=phrase(name, words), values=listed(said), meaning=meaning), []


def _meaning(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    return _meant(question.component or decision.components[0], words), []


def _meant(component: str, words: Mapping[str, Any]) -> str:
    meaning = words["meanings"].get(component)
    if meaning is None:
        return sentence(words["answers"]["no_meaning"].format(component=phrase(component, words)))
    return sentence(words["answers"]["meaning"].format(component=phrase(component, words), meaning=meaning))


def _values(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    said = []
    for c in question.about:
        values = listed([f"{phrase(name, words)} {number(c.values[name])}" for name in decision.components])
        key = "values" if len(decision.components) > 1 else "values_single"
        said.append(sentence(words["answers"][key].format(object=_named(c, decision), values=values, overall=number(c.overall))))
    return " ".join(said), []


def _where(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    said: list[str] = []
    computed: list[float] = []
    for c in question.about:
        if c.pixel is None:
            said.append(words["answers"]["no_place"].format(object=_named(c, decision)))
            continue
        x, y, z = c.position or (0.0, 0.0, 0.0)
        key = "where" if c.position is not None else "where_pixel"
        named = {"row": c.pixel[0], "column": c.pixel[1], "x": number(x), "y": number(y), "z": number(z)}
        said.append(words["answers"][key].format(object=_named(c, decision), **named))
        computed += [*c.pixel, x, y, z]
    return " ".join(map(sentence, said)), computed


def _list(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    lines = [f"{c.label}, {the(c.object)} (overall value {number(c.overall)})" for c in decision.candidates]
    return words["answers"]["list"].format(candidates=listed(lines)), []


def _scene(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    things = [thing for thing in decision.objects if thing.object_index is not None]
    if not things:
        return _list(question, decision, words)
    counts: dict[str, int] = {}
    for thing in things:
        counts[thing.object] = counts.get(thing.object, 0) + 1
    shown = [f"{NUMBERS[n] if n < len(NUMBERS) else n} {name}{'s' if n > 1 else ''}" for name, n in list(counts.items())[:_MOST_LISTED]]
    if len(counts) > _MOST_LISTED:
        shown.append("others")
    total = f"{NUMBERS[len(things)] if len(things) < len(NUMBERS) else len(things)} object{'s' if len(things) > 1 else ''}"
    return words["answers"]["scene"].format(total=total, things=listed(shown)), [float(len(things)), *map(float, counts.values())]


def _sure(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    chosen, error = decision.selected, decision.error
    # Beside the candidates, the best other object counts: it may be closer.
    others = question.about or [*decision.alternatives, *(o for o in decision.others[:1] if not _listed(o, decision))]
    others = [other for other in others if not together(chosen, other)]
    if not others:
        return words["answers"]["alone" if not question.about else "same_place"].format(object=the(chosen.object)), []
    gaps = [chosen.overall - other.overall for other in others]
    behind = listed(
        [f"{_named(o, decision)} is {number(abs(g))} {'behind' if g >= 0 else 'ahead'}" for o, g in zip(others, gaps, strict=True)]
    )
    text = sentence(words["answers"]["sure"].format(behind=behind))
    if error == 0:
        return f"{text} {words['answers']['sure_unknown']}", []
    open_ = [other for other, gap in zip(others, gaps, strict=True) if abs(gap) <= error]
    key = "sure_clear" if not open_ else "sure_open" if len(open_) == len(others) else "sure_mixed"
    against = listed([_named(other, decision) for other in open_]) if open_ else ""
    return f"{text} {words['answers'][key].format(error=number(error), against=against)}", []


def _robust(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    said = [sentences.robustness(decision, words)]
    if len(decision.components) > 1:
        others = question.about or decision.alternatives
        for other in [c for c in others if not together(c, decision.selected)]:
            delta = contrast.rdx(decision.selected.values, other.values)
            said.append(sentence(sentences.turn(delta, _named(other, decision), words)))
    return " ".join(said), []


def _what_if(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    """The choice of the same maps with other weights: one argmax more, no learning."""
    if min(question.factors.values()) < 0:
        return words["answers"]["what_if_negative"], []
    factors = {name: question.factors.get(name, 1.0) for name in decision.components}
    best, chosen = decision.best_under(factors), decision.selected

    def worth(candidate: Candidate) -> float:
        return sum(factors[name] * candidate.values[name] for name in decision.components)

    changes = [f"{phrase(name, words)} {'counted as much as now' if f == 1 else counted(f)}" for name, f in question.factors.items()]
    kept = together(best, chosen) or worth(chosen) >= worth(best) - 1e-9
    named = {"changes": listed(changes), "object": the(chosen.object), "overall": number(worth(best)), "kept": number(worth(chosen))}
    if kept:
        key = "what_if_kept"
    elif best.object == chosen.object:
        key = "what_if_elsewhere" if best.object_index is None else "what_if_another"
    else:
        key = "what_if_turned"
    named |= {"other": _named(best, decision) if key == "what_if_turned" else best.object}
    said = f"{words['answers'][key].format(**named)} {words['answers']['what_if_note']}"
    return sentence(said), [worth(best), worth(chosen), *question.factors.values()]


def _q_value(question: Question, decision: Decision, words: Mapping[str, Any]) -> Answer:
    names = listed([phrase(name, words) for name in decision.components])
    key = "q_value" if len(decision.components) > 1 else "q_value_single"
    chosen = decision.selected
    return words["answers"][key].format(components=names, object=the(chosen.object), overall=number(chosen.overall)), []


def _listed(thing: Candidate, decision: Decision) -> bool:
    return any(together(thing, candidate) for candidate in decision.candidates)


def _named(candidate: Candidate, decision: Decision) -> str:
    """A candidate in an answer: "the ground (A)"; one that bears the chosen one's name, but is not it, is "another" one."""
    chosen = decision.selected
    if candidate.label == SELECTED:
        return the(candidate.object)
    name = the(candidate.object)
    if candidate.object == chosen.object and not together(candidate, chosen):
        name = f"another {candidate.object}" if candidate.object_index is not None else f"another spot of {the(candidate.object)}"
    here = [c for c in decision.alternatives if (c.object, c.object_index) == (candidate.object, candidate.object_index)]
    if candidate.label == candidate.object and any(c.pixel != candidate.pixel for c in here):
        # A candidate lies on it too, elsewhere.
        return f"{name} at its best spot"
    return name if candidate.label in ("", candidate.object) else f"{name} ({candidate.label})"


_ANSWERS: dict[str, Callable[[Question, Decision, Mapping[str, Any]], Answer]] = {
    "help": _plain("help"),
    "rdx": _plain("rdx"),
    "thanks": _plain("thanks"),
    "scene_if": _plain("scene_if"),
    "missing": _missing,
    "no_component": _no_component,
    "shallow": _shallow,
    "contrastive": _contrastive,
    "pair": _pair,
    "runner_up": _runner_up,
    "component": _component,
    "component_of": _component_of,
    "meaning": _meaning,
    "values": _values,
    "where": _where,
    "list": _list,
    "scene": _scene,
    "sure": _sure,
    "robust": _robust,
    "what_if": _what_if,
    "q_value": _q_value,
}
