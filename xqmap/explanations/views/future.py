"""What is paid now and what can follow, in words; nothing where nothing follows or the two cannot be told apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from xqmap.explanations import contrast
from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.views.words import another, listed, number, phrase, sentence, signed, the

if TYPE_CHECKING:
    from xqmap.explanations.decision import Decision


def expected(decision: Decision, candidate: Candidate, words: Mapping[str, Any]) -> str:
    """What a candidate pays and what is expected to follow it; empty where no candidate has a future."""
    if not decision.foresees or candidate.now is None or candidate.later is None:
        return ""
    later = sum(candidate.later.values())
    names = {
        "object": the(candidate.object),
        "now": number(sum(candidate.now.values())),
        "now_values": _parts(candidate.now, words, number),
        "later": number(later),
        "later_values": _parts(candidate.later, words, number),
    }
    return sentence(str(words["future_nothing" if later <= decision.error else "future"]).format(**names))


def when(decision: Decision, first: Candidate, second: Candidate, words: Mapping[str, Any]) -> str:
    """Whether ``first`` is worth more than ``second`` for what it pays now or for what can follow it; empty where no
    candidate has a future.
    """
    if not decision.foresees or first.now is None or first.later is None or second.now is None or second.later is None:
        return ""
    now, later = contrast.rdx(first.now, second.now), contrast.rdx(first.later, second.later)
    sooner, following, error = sum(now.values()), sum(later.values()), decision.error
    if abs(following) <= error:
        key = "when_now"
    elif abs(sooner) <= error:
        key = "when_later"
    elif sooner > 0 and following > 0:
        key = "when_both"
    else:
        key = "when_more_later" if following > 0 else "when_less_later"
    nothing = sum(second.later.values()) <= error < sum(first.later.values())
    names = {
        "other": the(second.object) if second.object != first.object else another(second, words),
        "now": signed(sooner),
        "now_values": _parts(now, words, signed),
        "later": signed(following),
        "later_values": _parts(later, words, signed),
    }
    said = sentence(str(words[key]).format(**names))
    return f"{said} {sentence(str(words['when_nothing']).format(**names))}" if nothing else said


def played(decision: Decision, words: Mapping[str, Any]) -> list[str]:
    """What came of each candidate that was carried out, beside what was expected."""
    said = []
    for label, copies in decision.played.items():
        candidate = decision[label]
        came = {name: sum(returns[name] for returns in copies) / len(copies) for name in decision.components}
        names = {
            "object": the(candidate.object) if label == SELECTED else f"{the(candidate.object)} ({label})",
            "times": words["once"] if len(copies) == 1 else str(words["times"]).format(count=len(copies)),
            "came": number(sum(came.values())),
            "came_values": _parts(came, words, number),
            "expected": number(candidate.overall),
            "expected_values": _parts(candidate.values, words, number),
        }
        said.append(sentence(str(words["played"]).format(**names)))
    return said


def _parts(values: Mapping[str, float], words: Mapping[str, Any], form: Any) -> str:
    """Each component and its number, those that do not show left out."""
    shown = {name: value for name, value in values.items() if float(number(value))} or values
    return listed([f"{phrase(name, words)} {form(value)}" for name, value in shown.items()], words)
