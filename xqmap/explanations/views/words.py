"""How numbers, lists and names are written in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xqmap.explanations.candidate import Candidate


def number(value: float) -> str:
    """Two decimals, and no minus before zero."""
    text = f"{value:.2f}"
    return text.lstrip("-") if float(text) == 0 else text


def signed(value: float) -> str:
    """Two decimals with their sign."""
    text = number(value)
    return text if text.startswith("-") or float(text) == 0 else f"+{text}"


def listed(items: Sequence[str], words: Mapping[str, Any]) -> str:
    """Words as a list in a sentence: a; a and b; a, b and c."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {words['and']} {items[-1]}"


def counted(weight: float, words: Mapping[str, Any]) -> str:
    """How much a component counts, in words: "did not count", "counted half as much", "counted 1.30 times as much"."""
    known = words["counted"]
    return str(known.get(number(weight), known["times"])).format(times=number(weight))


def phrase(component: str, words: Mapping[str, Any]) -> str:
    """What a component is called in a sentence."""
    return str(words["components"].get(component, component))


def the(thing: str) -> str:
    """A thing's name with its article; one in »quotation marks«, of a language that inflects names, as it is."""
    return thing if thing.startswith(("the ", "a ", "an ", "another ", "»")) else f"the {thing}"


def sentence(text: str) -> str:
    """With a capital at its beginning."""
    return text[:1].upper() + text[1:]


def another(thing: Candidate, words: Mapping[str, Any]) -> str:
    """A thing that bears the name of one that was spoken of."""
    template = words["another_spot" if thing.object_index is None else "another"]
    return str(template).format(object=thing.object, the=the(thing.object))
