"""Understands a question about a decision well enough to answer it from the numbers: what is asked, and about whom."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from xqmap.explanations.decision import SELECTED, Candidate, Decision
from xqmap.explanations.naming import missing, named, plain

# How each kind of question is recognised, in the order in which they are tried.
ASKS = {
    "help": r"^(help|hello|hi|hey)\b|^$|what (can|could|may|should) (i|you)\b|what do you know",
    "thanks": r"^(thanks|thank you|ok|okay|great|good|nice|cool|i see|got it|bye)$",
    "what_if": r"\b(what|how) if\b|\bif\b|\bsuppose\b|\bimagine\b|\bassum|\bwithout\b|\bignor|\bwhat about .*\b(twice|half|times)\b",
    "sure": r"\b(un)?sure\b|\bcertain|\bconfiden|\btrust\b|\breliab|\bdoubt|toss-?up|\bnoise\b|\berrors?\b|\bclear (choice|winner|call)",
    "robust": r"\bflip|change your (mind|choice)|what would it take|\brobust|how close|turn the (choice|decision)|\bnarrow\b|\btight\b",
    "rdx": r"\b(rdx|msx)\b",
    "q_value": r"\bq-?\s?(values?|maps?)\b|\boverall value\b.*\bmean|what (is|does) (the|an) overall value",
    "meaning": r"\bmeans?\b|\bmeaning\b|\bdefin|stands? for|\bmeasure|what (is|are|'s) (a |an |the )?[\w-]+\??$",
    "where": r"\bwhere\b|\bposition\b|\bcoordinates?\b|\blocation\b",
    "runner_up": r"second[- ]best|runner|next best|something else|anything else|anywhere else|somewhere else|another (one|place|spot)",
    "component": r"\b(which|what)\b.*(component|propert|contribut|factor|matter|mostly|most\b|feature|criteri)|main reason|most important",
    "contrastive": r"\bwhy\b.*\b(not|rather|instead|over|than|better)\b|\bwhy (did|do|have|are|was|is|could|would)n.?t\b|\bcompare"
    r"|\bversus\b|\bvs\b|\bdifferen|\b(better|worse|best) (than|of)\b|\bwrong with\b|\bagainst\b|\binstead of\b",
    "list": r"\b(what|which|who|list|show|name)\b.*\b(candidates?|options?|alternatives?|choices)\b|what else",
    "scene": r"^(?!.*\bbest\b).*(what (do|can|did) you see|what('s| is| are) (there|in|on)\b"
    r"|\b(what|which|how many|list|name|show)( me)?( all)?( the)? "
    r"(objects?|things?|blocks?|cubes?|bowls?|scene)\b)",
    "component_of": r"\bhow\b|\bwhat\b|\bvalue\b|\brole\b|^(is|was|does|did|are)\b|\bscore|\btell me\b|\bmuch\b",
    "values": r"\bvalues?\b|\bhow good\b|\bscore|\bworth\b|\bnumbers?\b|\btell me about\b|\bwhat is\b|\bhow much\b",
    "shallow": r"\bwhy\b|\bexplain|\breasons?\b|\bwhat made\b|\bhow come\b|what (did|do|will|have) you (choose|chosen|pick|select)"
    r"|\bwhat is selected\b|\bjustify\b|which (one|object)? ?did you|\bwhat was your (choice|decision)\b|\bhow did you decide\b|\bbest\b",
}
NUMBERS = ["zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
_FACTORS = {
    r"n[o']t\b|n't\b|\bnothing\b|\bno longer\b|\bignor|\bwithout\b|\bremove|\bdrop|\bzero\b|\boff\b|\birrelevant": 0.0,
    r"\bhalf\b|\bhalv": 0.5,
    r"\bthird\b": 1 / 3,
    r"\bquarter\b": 0.25,
    r"\btwice\b|\bdoubl": 2.0,
    r"\btripl|\bthrice\b": 3.0,
    r"\bless\b|\bleast\b|\blower\b": 0.5,
    r"\bmore\b|\bmost\b|\bhigher\b": 2.0,
    r"\bsame\b|\bequal|\bas now\b": 1.0,
}
_WEIGHED = r"\bcount|\bmatter|\bweigh|\bimport|\bcare|\brelevan|\bvalue"
# Kinds that "and B?" can repeat for somebody else.
_REPEATED = ("contrastive", "what_if", "component", "component_of", "sure", "robust", "values", "where", "meaning")


@dataclass
class Question:
    """What was understood.

    Attributes:
        kind: a key of ``ASKS``, ``pair`` (two candidates of which neither was chosen), ``scene_if`` (another scene), ``missing`` (of a
            thing that is not there), ``no_component`` (of a property without a Q-Map of its own) or ``unknown``.
        about: the candidates or objects that are named.
        component: the component that is named, if any.
        factors: for ``what_if``, how many times as much a component counts, by name.
        thing: what is missing.
    """

    kind: str
    about: list[Candidate] = field(default_factory=list)
    component: str | None = None
    factors: dict[str, float] = field(default_factory=dict)
    thing: str = ""


def understand(text: str, decision: Decision, words: Mapping[str, Any], before: Question | None = None) -> Question:
    """Reads a question.

    Args:
        text: what the person typed.
        decision: what it is about.
        words: the task's wording, for what components are called.
        before: the question before this one, which "and B?" refers back to.
    """
    said = plain(text)
    about, component = named(text, decision), component_in(said, decision.components, words)
    others = [candidate for candidate in about if candidate.label != SELECTED]
    if thing := missing(text, decision):
        return Question("missing", thing=thing)
    follows = re.search(r"^(and|what about|how about|or)\b", said) is not None
    if before is not None and follows and not re.search(r"\bwhy\b|\bif\b", said) and (again := _again(said, before, others, component)):
        return again
    kind = next((kind for kind, pattern in ASKS.items() if re.search(pattern, said) and _fits(kind, said, about, component)), "unknown")
    strange = [name for name in (*words["components"], *words["other_properties"]) if name not in decision.components]
    foreign = component_in(said, strange, words)
    if foreign and not component and kind in ("what_if", "component_of", "meaning", "component", "unknown"):
        return Question("no_component", component=foreign)
    if kind == "what_if":
        factors = factors_in(said, decision, words)
        return Question("what_if" if factors else "scene_if", about, component, factors)
    if kind == "contrastive":
        one_by_one = re.search(r"\bwhy\b.*\bnot\b|n.?t\b", said)
        if len(others) == 2 and len(about) == 2 and not one_by_one:
            return Question("pair", others)
        return Question("contrastive", others or decision.others[:1])
    if kind in ("component_of", "values", "where") and not about:
        refers = before is not None and before.about and re.search(r"\b(it|its|that|this one|there)\b", said)
        return Question(kind, before.about if before is not None and refers else [decision.selected], component)
    if kind == "shallow" and others:
        return Question("contrastive", others)
    if kind == "unknown" and others:
        return Question("contrastive", others)
    return Question(kind, about if kind in ("component_of", "values", "where") else others, component)


def _fits(kind: str, said: str, about: list[Candidate], component: str | None) -> bool:
    """Whether a pattern that matched can be meant, given who and what is named."""
    if kind in ("component_of", "meaning"):
        return component is not None and not (kind == "meaning" and about)
    if kind == "values":
        return bool(about) or re.search(r"\bit\b|\byour choice\b|\bchosen\b", said) is not None
    if kind == "q_value":
        return not about
    if kind == "what_if":
        return component is not None or re.search(r"\bif\b|\bsuppose\b|\bimagine\b|\bassum|\bwithout\b", said) is not None
    return True


def _again(said: str, before: Question, others: list[Candidate], component: str | None) -> Question | None:
    """The question before, about somebody or something else: "and B?", "and 3 times as much?", "what about flatness?"."""
    if before.kind == "pair" and others:
        return Question("contrastive", others)
    if before.kind not in _REPEATED:
        return None
    if before.kind == "what_if":
        factor, known = _factor(said), next(iter(before.factors.values()))
        if component is None and factor is None:
            return None
        names = [component] if component else list(before.factors)
        return Question("what_if", [], names[0], dict.fromkeys(names, known if factor is None else factor))
    if others:
        return Question(before.kind, others, component or before.component)
    return Question(before.kind, before.about, component) if component and before.kind in ("component_of", "meaning") else None


def component_in(said: str, components: Any, words: Mapping[str, Any]) -> str | None:
    """The first of the components that a plain text names, by its name or a synonym."""
    for name in components:
        calls = [name, str(words["components"].get(name, name)), *words["synonyms"].get(name, [])]
        if any(re.search(rf"\b{re.escape(call.lower())}\b", said) for call in calls):
            return str(name)
    return None


def factors_in(said: str, decision: Decision, words: Mapping[str, Any]) -> dict[str, float]:
    """How many times as much each component counts in a supposition: one clause at a time, so that two can change."""
    factors: dict[str, float] = {}
    for clause in re.split(r",(?!\d)|\band\b|\bbut\b|\bwhile\b", said):
        name = component_in(clause, decision.components, words)
        if name is None:
            continue
        if re.search(r"\b(only|just|nothing but|alone)\b", clause):
            return {other: 0.0 for other in decision.components if other != name}
        factor = _factor(clause)
        if factor is None and re.search(_WEIGHED, clause):
            continue
        if factor is not None:
            factors[name] = factor
    if not factors and (name := component_in(said, decision.components, words)) and (factor := _factor(said)) is not None:
        factors[name] = factor
    return factors


def _factor(said: str) -> float | None:
    if share := re.search(r"(\d+(?:[.,]\d+)?)\s*(?:%|percent)\s*(more|less)?", said):
        amount = float(share.group(1).replace(",", ".")) / 100
        return {"more": 1 + amount, "less": max(0.0, 1 - amount)}.get(share.group(2), amount)
    number = re.search(r"(-?\d+(?:[.,]\d+)?)\s*(?:times|x\b|as much)", said)
    if number:
        return float(number.group(1).replace(",", "."))
    if word := re.search(rf"\b({'|'.join(NUMBERS)}) times\b", said):
        return float(NUMBERS.index(word.group(1)))
    return next((factor for pattern, factor in _FACTORS.items() if re.search(pattern, said)), None)
