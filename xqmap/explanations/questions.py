"""Understands a question about a decision well enough to answer it from the numbers: who it is about, and what is asked."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from xqmap.explanations.decision import SELECTED, Candidate, Decision

_FACTORS = {"not": 0.0, "nothing": 0.0, "half": 0.5, "less": 0.5, "twice": 2.0, "double": 2.0, "more": 2.0, "triple": 3.0}
# Words that describe no thing.
_PLAIN = frozenset(("other", "chosen", "selected", "best", "next", "first", "second", "same", "right", "left", "which", "one"))
_COUNT = r"count|matter|weigh|import|care|value"


@dataclass
class Question:
    """What was understood.

    Attributes:
        kind: ``shallow``, ``contrastive``, ``what_if``, ``component``, ``sure``, ``q_value``, ``list``, ``component_of``, ``robust``,
            ``help``, ``missing`` (of a thing that is not there, named in ``component``) or ``unknown``.
        about: the candidates or objects that are named.
        component: the component that is named, if any.
        weight: for ``what_if``, the factor on that component.
    """

    kind: str
    about: list[Candidate] = field(default_factory=list)
    component: str | None = None
    weight: float | None = None


def understand(text: str, decision: Decision, words: Mapping[str, Any], before: Question | None = None) -> Question:
    """Reads a question.

    Args:
        text: what the person typed.
        decision: what it is about.
        words: the task's wording, for what components are called.
        before: the question before this one, which "and B?" refers back to.
    """
    said = " ".join(re.sub(r"[^\w\s.,'-]", " ", text.lower()).split())
    about, component, weight = named(text, decision), _component(said, decision, words), _weight(said)
    others = [candidate for candidate in about if candidate.label != SELECTED]

    def asks(pattern: str) -> bool:
        return re.search(pattern, said) is not None

    if thing := missing(text, decision):
        return Question("missing", component=thing)
    if not said or asks(r"^(help|\?)$|what can (i|you)"):
        return Question("help")
    if asks(r"\bwhat if\b|\bif\b|\bsuppose\b|\bimagine\b") and component and (weight is not None or asks(_COUNT)):
        return Question("what_if", about, component, 0.0 if weight is None else weight)
    if asks(r"\bsure\b|\bcertain|\bconfiden|\btrust\b|\breliab|\bdoubt|toss-?up|\bnoise\b|\berror\b"):
        return Question("sure", others)
    if asks(r"\bflip\b|change your (mind|choice)|what would it take|\brobust|how close|turn the (choice|decision)"):
        return Question("robust", others)
    if asks(r"q-?\s?values?\b.*(here|mean|is)|what (is|are|does) (a |the )?(q-?\s?(value|map)|value mean)|\bq-?\s?maps?\b"):
        return Question("q_value", component=component)
    if asks(r"\b(what|which) (were|are|other)?.*(candidates|options|alternatives|choices)|what else|list "):
        return Question("list")
    if asks(
        r"\bwhy\b.*\b(not|rather|instead|over|than|and not)\b|\bcompare|\bversus\b|\bvs\b|\bdifferen|\bbetter\b|\bwrong with\b|why didn"
    ):
        return Question("contrastive", others or decision.alternatives[:1])
    if asks(r"\b(which|what)\b.*(component|propert|contribut|factor|matter|mostly|most)|main reason|most important"):
        return Question("component", others, component)
    if component and asks(r"\bhow (much|flat|good|high|well|about)\b|\bwhat (is|about|was)\b|\bvalue\b|\brole\b|\bdid\b|\bdoes\b|how "):
        return Question("component_of", about or [decision.selected], component)
    if asks(r"\bwhy\b|\bexplain\b|\breason\b|\bwhat made\b|\bhow come\b|\bwhat did you (choose|pick|select)|\bwhat is selected\b"):
        return Question("contrastive", others) if others else Question("shallow")
    if others:
        # "And B?": the same question, about somebody else.
        if before is not None and before.kind not in ("help", "unknown", "list", "q_value"):
            return Question(before.kind, others, before.component, before.weight)
        return Question("contrastive", others)
    if before is not None and asks(r"^(and|what about|how about)\b") and (component or weight is not None):
        return Question(before.kind, before.about, component or before.component, weight if weight is not None else before.weight)
    if about and asks(r"value|how good|score|much"):
        return Question("shallow")
    return Question("unknown")


def named(text: str, decision: Decision) -> list[Candidate]:
    """The candidates a text names: by label ("B", "pixel B"), object ("the red flat block") or part of one ("the red one")."""
    found: list[Candidate] = []

    def add(candidate: Candidate) -> None:
        if candidate.label not in [c.label for c in found]:
            found.append(candidate)

    lowered = text.lower()
    for candidate in decision.candidates:
        # A one-letter label counts in capitals only, and not the article at a sentence's beginning.
        label = re.escape(candidate.label)
        if candidate.label == SELECTED:
            if re.search(r"\bselected\b", lowered):
                add(candidate)
        elif re.search(rf"\b(?:pixel|candidate|option|spot|point|label)\s+{label.lower()}\b", lowered) or re.search(
            rf"(?<!\w){label}(?=$|[\s?.,!)])(?! [a-z]+ (?:block|cube|bowl))", text
        ):
            add(candidate)
    pool = [*decision.candidates, *(Candidate(o.object, o.object, o.values, o.pixel, None, o.object_index) for o in decision.objects)]
    matching = [c for c in pool if c.object.lower() in lowered]
    if not matching and not found and not missing(text, decision):
        # "The red one", "the cube": the objects that share most of the question's words.
        words = set(re.findall(r"[a-z]+", lowered))
        scores = [len(words & set(c.object.lower().split())) for c in pool]
        matching = [c for c, score in zip(pool, scores, strict=True) if score == max(scores) > 0]
        others = [c for c in matching if c.label != SELECTED and c.object_index != decision.selected.object_index]
        matching = [c for c in matching if c.label == SELECTED] + others[:1]
    seen: set[tuple[str, int | None]] = {(c.object, c.object_index) for c in found}
    for candidate in matching:
        if (candidate.object, candidate.object_index) not in seen:
            seen.add((candidate.object, candidate.object_index))
            add(candidate)
    return found


def missing(text: str, decision: Decision) -> str | None:
    """A thing the text names that is not in the scene ("the green cube" where no cube is green); None where there is none."""
    names = [c.object.lower().split() for c in decision.candidates] + [o.object.lower().split() for o in decision.objects]
    nouns = {name[-1] for name in names} | {"one", "cube", "bowl", "block"}
    lowered = text.lower()
    if any(" ".join(name) in lowered for name in names):
        return None
    for match in re.finditer(rf"\b(?:the|a|an|that)\s+((?:[a-z]+\s+){{0,2}})({'|'.join(sorted(map(re.escape, nouns)))})\b", lowered):
        described = [word for word in match.group(1).split() if word not in _PLAIN]
        noun = [match.group(2)] if match.group(2) != "one" else []
        if (described or noun) and not any(set(described + noun) <= set(name) for name in names) and set(described + noun) - _PLAIN:
            return " ".join([*described, match.group(2)])
    return None


def _component(said: str, decision: Decision, words: Mapping[str, Any]) -> str | None:
    for name in decision.components:
        calls = [name, str(words["components"].get(name, name)), *words.get("synonyms", {}).get(name, [])]
        if any(re.search(rf"\b{re.escape(call.lower())}\b", said) for call in calls):
            return name
    return None


def _weight(said: str) -> float | None:
    number = re.search(r"(\d+(?:[.,]\d+)?)\s*(?:times|x\b|×|as much)", said)
    if number:
        return float(number.group(1).replace(",", "."))
    for word, factor in _FACTORS.items():
        if re.search(rf"\b{word}\b|\b{word}d\b", said) or (word == "not" and re.search(r"n't|no longer|ignor|without", said)):
            return factor
    return None
