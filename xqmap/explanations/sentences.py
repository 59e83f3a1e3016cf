"""A decision in words, from templates. Every number is one of the decision's, printed by :func:`number` or :func:`signed`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

import conf
from xqmap.explanations import contrast
from xqmap.explanations.decision import SELECTED, Decision

WORDING = Path(conf.__path__[0]) / "explain" / "wording"


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


def wording_for(task: str) -> dict[str, Any]:
    """The templates of a task (``conf/explain/wording``), or the plain ones."""
    own = WORDING / f"{task}.yaml"
    plain = OmegaConf.load(WORDING / "plain.yaml")
    # A task's name may come from a stranger's file: only a plain name can point into the folder.
    merged = OmegaConf.merge(plain, OmegaConf.load(own)) if task.isidentifier() and own.exists() else plain
    return {key: value for key, value in OmegaConf.to_container(merged).items() if key != "defaults"}  # type: ignore[union-attr, misc]


def write(decision: Decision, wording: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """All sentences of a decision.

    Args:
        decision: what is explained.
        wording: templates; those of the decision's task when not given.

    Returns:
        ``{"shallow": str, "contrastive": [one per alternative], "robustness": str}``.
    """
    words = dict(wording) if wording is not None else wording_for(decision.task)
    return {
        "shallow": shallow(decision, words),
        "contrastive": [contrastive(decision, SELECTED, other.label, words) for other in decision.alternatives],
        "robustness": robustness(decision),
    }


def shallow(decision: Decision, words: Mapping[str, Any]) -> str:
    """Why this one: the object with the highest overall value and the component that contributes most."""
    chosen, best = decision.selected, decision.shallow
    return words["shallow"].format(
        verb=words["verb"],
        object=chosen.object,
        overall=number(chosen.overall),
        component=_phrase(best, words),
        value=number(chosen.values[best]),
    )


def contrastive(decision: Decision, first: str, second: str, words: Mapping[str, Any]) -> str:
    """Why the candidate ``first`` and not ``second``: through which properties it wins, through which it does not, what would turn it.

    Where the two coincide, are equal or differ by less than the values' typical error, the sentence says that instead.
    """
    a, b = decision[first], decision[second]
    names = {"verb": words["verb"], "object": a.object, "other": b.object, "label": second}
    if b.label == b.object:
        # An object that is no candidate goes by its name alone.
        words = {key: value.replace(" ({label})", "") if isinstance(value, str) else value for key, value in words.items()}
    if a.pixel is not None and a.pixel == b.pixel:
        own = [_phrase(c, words) for k, c in enumerate(decision.components) if _labels(decision, k) == second] or ["one component"]
        return words["same_pixel"].format(**names, labels=second, are="is", component=listed(own))
    if decision.same(first, second):
        return words["same_object"].format(**names, labels=second, lie="lies")
    delta = decision.rdx(first, second)
    gap = sum(delta.values())
    if gap < 0:
        return contrastive(decision, second, first, words)
    if decision.within_noise(first, second):
        error = math.hypot(*(decision.noise.get(name, 0.0) for name in decision.components))
        template = "within_noise" if error > 0 else "equal"
        return words[template].format(**names, gap=number(gap), error=number(error))
    pro = sorted((n for n in delta if signed(delta[n]).startswith("+")), key=lambda n: -delta[n])
    con = sorted((n for n in delta if signed(delta[n]).startswith("-")), key=lambda n: delta[n])
    if not pro:
        return words["equal"].format(**names)
    text = words["contrastive_both" if con else "contrastive"].format(
        **names,
        pro=listed([_phrase(n, words) for n in pro]),
        speaks_for="speaks" if len(pro) == 1 else "speak",
        pro_values=listed([signed(delta[n]) for n in pro]),
        con=listed([_phrase(n, words) for n in con]) if con else "",
        speaks_against="speaks" if len(con) == 1 else "speak",
        con_values=listed([signed(delta[n]) for n in con]) if con else "",
    )
    return " ".join([text, *_enough(delta, len(pro), words), _turn(delta, b.object, words)])


def robustness(decision: Decision) -> str:
    """How far the weights would have to move, together, for another object to be chosen."""
    found = decision.robustness()
    if found is None:
        return "There is no other object that a change of weights could turn the choice to."
    distance, name = found
    if not math.isfinite(distance):
        return f"The {name} has the same values, so no change of weights tells the two apart."
    return f"The smallest joint change of the weights that would turn the choice, to the {name}, has the size {number(distance)}."


def _enough(delta: Mapping[str, float], reasons: int, words: Mapping[str, Any]) -> list[str]:
    """With more than two components: the smallest sufficient set of reasons, where it is smaller than all of them."""
    if len(delta) <= 2:
        return []
    plus, minus = contrast.msx(delta)
    if not minus and not any(value < 0 for value in delta.values()):
        return []
    said = []
    if plus and len(plus) < reasons:
        said.append(
            words["msx"].format(plus=listed([_phrase(n, words) for n in plus]), outweighs="outweighs" if len(plus) == 1 else "outweigh")
        )
    if minus:
        said.append(
            words["msx_minus"].format(plus=listed([_phrase(n, words) for n in plus]), minus=listed([_phrase(n, words) for n in minus]))
        )
    return said


def _turn(delta: Mapping[str, float], other: str, words: Mapping[str, Any]) -> str:
    found = contrast.nearest_flip(delta)
    if found is None:
        return words["no_flip"].format(other=other)
    component, weight = found
    return words["flip"].format(component=_phrase(component, words), weight=number(weight), other=other)


def _phrase(component: str, words: Mapping[str, Any]) -> str:
    return str(words["components"].get(component, component))


def _labels(decision: Decision, k: int) -> str:
    """The label of the k-th component's own candidate, where the decision has one per component."""
    others = decision.alternatives
    return others[k].label if len(others) == len(decision.components) else ""
