"""A decision in words, from templates. Every number is one of the decision's, printed by :func:`number` or
:func:`signed`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from xqmap.config import plugins
from xqmap.explanations import contrast
from xqmap.explanations.candidate import SELECTED, Candidate, together
from xqmap.explanations.views import future
from xqmap.explanations.views.words import another, counted, listed, number, phrase, sentence, signed, the

if TYPE_CHECKING:
    from xqmap.explanations.decision import Decision


def wording_for(task: str, language: str = "") -> dict[str, Any]:
    """The templates of a task (``conf/explain/wording``) over those that its file names as ``defaults``, or the plain
    ones; of a ``language``, those of its files (``landing_de``) over them.
    """
    files = ["plain", task, *([f"plain_{language}", f"{task}_{language}"] if language else [])]
    merged = OmegaConf.merge(*map(_wording, files))
    return {str(key): value for key, value in OmegaConf.to_container(merged).items()}  # type: ignore[union-attr]


def wording_of(decision: Decision, language: str = "") -> dict[str, Any]:
    """The templates that a decision is told in, see :func:`wording_for`: its task's; where that has none of its own,
    and no cell of a map was chosen, those of ``actions``.
    """
    own = plugins.find("explain", "wording", f"{decision.task}.yaml") is not None
    task = decision.task if own or decision.selected.pixel is not None else "actions"
    return wording_for(task, language)


def _wording(name: str) -> DictConfig:
    path = plugins.find("explain", "wording", f"{name}.yaml")
    content = OmegaConf.load(path) if path else OmegaConf.create()
    assert isinstance(content, DictConfig)
    merged = OmegaConf.merge(*map(_wording, content.pop("defaults", [])), content)
    assert isinstance(merged, DictConfig)
    return merged


def write(decision: Decision, wording: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """All sentences of a decision.

    Args:
        decision: what is explained.
        wording: templates; those of the decision's task when not given.

    Returns:
        ``{"shallow": str, "contrastive": [str], "robustness": str}``, ``"future"`` where something follows, and
        ``"played"`` (a list) where candidates were carried out. The contrastive ones go by candidate; candidates on the
        chosen object share one. The best other object has one where no candidate is elsewhere, and where it is within
        the values' typical error.
    """
    words = dict(wording) if wording is not None else wording_of(decision)
    elsewhere = [c for c in decision.alternatives if not decision.same(SELECTED, c.label)]
    said = (
        [_agreeing(decision, words)]
        if len(elsewhere) < len(decision.alternatives) and len(decision.components) > 1
        else []
    )
    best = decision.others[:1]
    close = [
        o
        for o in best
        if decision.selected.overall - o.overall <= decision.error and not any(together(o, c) for c in elsewhere)
    ]
    elsewhere += close if elsewhere else best
    said += [contrastive(decision, decision.selected, other, words) for other in apart(elsewhere)]
    following = future.expected(decision, decision.selected, words)
    result = {"shallow": shallow(decision, words), "contrastive": said, "robustness": robustness(decision, words)}
    result |= {"future": following} if following else {}
    return result | ({"played": future.played(decision, words)} if decision.played else {})


def apart(things: Sequence[Candidate]) -> list[Candidate]:
    """Without those that are another's action under another letter."""
    kept: list[Candidate] = []
    for thing in things:
        if not any(together(thing, other) and thing.values == other.values for other in kept):
            kept.append(thing)
    return kept


def why(decision: Decision) -> str:
    """The sentences of a decision, one a line."""
    said = decision.sentences()
    return "\n".join([said["shallow"], *after(said)])


def after(said: Mapping[str, Any]) -> list[str]:
    """What is said after the first sentence, of :func:`write`."""
    return [
        *([said["future"]] if "future" in said else []),
        *said["contrastive"],
        *said.get("played", []),
        said["robustness"],
    ]


def shallow(decision: Decision, words: Mapping[str, Any]) -> str:
    """Why this one: the object with the highest overall value and the component that contributes most."""
    chosen = decision.selected
    names = {"verb": words["verb"], "object": the(chosen.object), "overall": number(chosen.overall)}
    if better := [
        c for c in decision.alternatives if number(c.overall) != number(chosen.overall) and c.overall > chosen.overall
    ]:
        return words["shallow_not_highest"].format(
            **names, other=listed([f"{the(c.object)} ({c.label})" for c in better], words)
        )
    if len(decision.components) == 1:
        return words["shallow_single"].format(**names)
    first, second = sorted(decision.components, key=lambda name: -chosen.values[name])[:2]
    names |= {"Component": sentence(phrase(first, words)), "value": number(chosen.values[first])}
    names |= {"second": phrase(second, words), "second_value": number(chosen.values[second])}
    close = chosen.values[first] - chosen.values[second] <= decision.error > 0
    return sentence(words["shallow_close" if close else "shallow"].format(**names))


def contrastive(decision: Decision, first: Candidate, second: Candidate, words: Mapping[str, Any]) -> str:
    """Why ``first`` and not ``second``: through which properties it wins, through which it does not, and what would
    turn it.

    Where the two coincide, are equal or differ by no more than the values' typical error, the sentence says that
    instead.
    """
    chose = first.label == SELECTED
    if together(first, second):
        return _same(first, second, words)
    delta = contrast.rdx(first.values, second.values)
    gap = sum(delta.values())
    if gap < 0 and not chose:
        return contrastive(decision, second, first, words)
    names = {
        "verb": words["verb"],
        "object": the(first.object),
        "first": _called(first),
        "other": _other(first, second, words),
        "labeled": _called(second, _other(first, second, words)),
        "gap": number(abs(gap)),
        "error": number(decision.error),
    }
    if number(gap) == "0.00":
        return sentence(words["equal"].format(**names))
    if abs(gap) <= decision.error:
        return sentence(words["within_noise"].format(**names))
    if len(delta) == 1:
        return sentence(words["single" if gap > 0 else "lower_single"].format(**names))
    pro = sorted((n for n in delta if signed(delta[n]).startswith("+")), key=lambda n: -delta[n])
    con = sorted((n for n in delta if signed(delta[n]).startswith("-")), key=lambda n: delta[n])
    if gap < 0:
        pro, con = con, pro
    kind = "lower" if gap < 0 else "contrastive" if chose else "pair"
    text = words[f"{kind}_both" if con else kind].format(
        **names,
        pro=listed([phrase(n, words) for n in pro], words),
        speaks_for="speaks" if len(pro) == 1 else "speak",
        pro_values=listed([signed(delta[n]) for n in pro], words),
        con=listed([phrase(n, words) for n in con], words) if con else "",
        speaks_against="speaks" if len(con) == 1 else "speak",
        con_values=listed([signed(delta[n]) for n in con], words) if con else "",
    )
    if gap < 0:
        return sentence(text)
    more = [*_enough(delta, len(pro), words), future.when(decision, first, second, words)]
    return " ".join(sentence(part) for part in [text, *more, turn(delta, names["other"], words)] if part)


def _same(first: Candidate, second: Candidate, words: Mapping[str, Any]) -> str:
    """Of two candidates on one object: whose spot on it is better."""
    names = {"first": referred(first, words), "second": referred(second, words), "object": the(first.object)}
    delta = contrast.rdx(first.values, second.values)
    if sum(delta.values()) < 0:
        delta = contrast.rdx(second.values, first.values)
    gap = number(sum(delta.values()))
    if first.pixel == second.pixel and first.pixel is not None:
        return sentence(words["same_pixel"].format(**names))
    if gap == "0.00":
        return sentence(words["same_object"].format(**names))
    better = names["first" if first.overall > second.overall else "second"]
    values = listed([f"{phrase(name, words)} {signed(value)}" for name, value in delta.items()], words)
    template = words["same_object_better" if len(delta) > 1 else "same_object_single"]
    return sentence(template.format(**names, better=better, gap=gap, values=values))


def referred(candidate: Candidate, words: Mapping[str, Any]) -> str:
    """A candidate by its letter alone: "my choice", "candidate (B)"; one without a letter by its object."""
    if candidate.label == SELECTED:
        return str(words["own_choice"])
    return (
        str(words["lettered"]).format(label=candidate.label)
        if candidate.label != candidate.object
        else the(candidate.object)
    )


def robustness(decision: Decision, words: Mapping[str, Any]) -> str:
    """How far the weights would have to move, together, for another object to be chosen."""
    if len(decision.components) == 1:
        return str(words["robust_single"])
    found = decision.robustness()
    if found is None:
        return str(words["robust_alone"])
    distance, name = found
    other = the(name) if name != decision.selected.object else str(words["another"]).format(object=name)
    if not math.isfinite(distance):
        return sentence(words["robust_never"].format(other=other))
    return sentence(words["robust"].format(other=other, distance=number(abs(distance))))


def turn(delta: Mapping[str, float], other: str, words: Mapping[str, Any]) -> str:
    """What it would take: the weight of one component at which the other would be just as good."""
    found = contrast.nearest_flip(delta)
    if found is None:
        return str(words["no_flip"]).format(other=other)
    return str(words["flip"]).format(component=phrase(found[0], words), counted=counted(found[1], words), other=other)


def _called(candidate: Candidate, name: str = "") -> str:
    """A candidate by its object and label, like "the ground (A)"; an object that is no candidate goes by its name
    alone.
    """
    name = name or the(candidate.object)
    return name if candidate.label in (SELECTED, candidate.object) else f"{name} ({candidate.label})"


def _other(first: Candidate, second: Candidate, words: Mapping[str, Any]) -> str:
    return the(second.object) if first.object != second.object else another(second, words)


def _agreeing(decision: Decision, words: Mapping[str, Any]) -> str:
    """One sentence on all candidates that lie on the chosen object."""
    chosen, others = decision.selected, decision.alternatives
    whose = (
        dict(zip((c.label for c in others), decision.components, strict=False))
        if len(others) == len(decision.components)
        else {}
    )
    here = [c for c in others if decision.same(SELECTED, c.label)]
    spots = [f"{phrase(whose[c.label], words)} ({c.label})" if c.label in whose else f"({c.label})" for c in here]
    exact = all(c.pixel is not None and c.pixel == chosen.pixel for c in here)
    template = words["agreeing_spot" if exact else "agreeing"]
    many = len(here) > 1
    return sentence(
        str(template).format(
            verb=words["verb"],
            object=the(chosen.object),
            spots=listed(spots, words),
            spot="spots" if many else "spot",
            are="are" if many else "is",
            lie="lie" if many else "lies",
            components=listed([phrase(whose.get(c.label, c.label), words) for c in here], words),
            agree="agree" if many else "agrees",
        )
    )


def _enough(delta: Mapping[str, float], reasons: int, words: Mapping[str, Any]) -> list[str]:
    """With more than two components: the smallest sufficient set of reasons, where it is smaller than all of them."""
    if len(delta) <= 2 or not any(value < 0 for value in delta.values()):
        return []
    plus, minus = contrast.msx(delta)
    said = []
    if plus and len(plus) < reasons:
        own, outweighs = ("its own", "outweighs") if len(plus) == 1 else ("their own", "outweigh")
        said.append(
            words["msx"].format(own=own, plus=listed([phrase(n, words) for n in plus], words), outweighs=outweighs)
        )
    if minus:
        said.append(words["msx_minus"].format(minus=listed([phrase(n, words) for n in minus], words)))
    return said
