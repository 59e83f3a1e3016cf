"""How numbers, lists and names are written in a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def number(value: float) -> str:
    """Two decimals, and no minus before zero."""
    text = f"{value:.2f}"
    return text.lstrip("-") if float(text) == 0 else text


def signed(value: float) -> str:
    """Two decimals with their sign."""
    text = number(value)
    return text if text.startswith("-") or float(text) == 0 else f"+{text}"


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence: a; a and b; a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def counted(weight: float) -> str:
    """How much a component counts, in words: "did not count", "counted half as much", "counted 1.30 times as much"."""
    known = {"0.00": "did not count", "0.50": "counted half as much", "2.00": "counted twice as much"}
    return known.get(number(weight), f"counted {number(weight)} times as much")


def phrase(component: str, words: Mapping[str, Any]) -> str:
    """What a component is called in a sentence."""
    return str(words["components"].get(component, component))


def the(thing: str) -> str:
    """A thing's name with its article."""
    return thing if thing.startswith(("the ", "a ", "an ", "another ")) else f"the {thing}"


def sentence(text: str) -> str:
    """With a capital at its beginning."""
    return text[:1].upper() + text[1:]
