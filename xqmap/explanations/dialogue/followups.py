"""Questions that go on with the one before: "and B?", "the left one", "and 3 times as much?"."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.dialogue.factors import factor_in
from xqmap.explanations.dialogue.language import Language, Token, intents
from xqmap.explanations.dialogue.mentions import Mention, is_own
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.dialogue.question import ABOUT_ALL, Question


def answered(
    before: Question,
    mentions: list[Mention],
    about: list[Candidate],
    tokens: list[Token],
    places: Places,
    language: Language,
) -> Question | None:
    """The question that was left open, about the one of the options that is meant now."""
    assert before.again is not None
    ordinals = language.content["ordinals"]
    order = next((int(ordinals[t.word]) for t in tokens if t.word in ordinals), 0)
    options = before.about
    if 0 < order <= len(options) or order == -1:
        meant = [options[order - 1 if order > 0 else -1]]
    else:
        named = [c for m in mentions for c in m.things if any(c is option for option in options)]
        sides = [word for m in mentions for word in m.places]
        there = [c for c in options if places.lies(c, sides)] if sides else []
        if sides and not there:
            there = places.farthest(options, sides)[:1]
        meant = there or distinct(named) or [c for c in about if any(c is option for option in options)]
    if len(meant) != 1:
        return None
    rest = [*before.again.about, *meant]
    others = [c for c in rest if not is_own(c)]
    kept = rest if before.again.kind in ABOUT_ALL or not others else others
    return replace(before.again, about=kept, subject=meant)


def goes_on(tokens: list[Token], language: Language) -> bool:
    """Whether a question begins as one that goes on."""
    words = [t.word for t in tokens]
    return any(words[: len(p.split())] == p.split() for p in language.content["goes_on"])


def again(
    before: Question,
    others: list[Candidate],
    about: list[Candidate],
    now: Question,
    tokens: list[Token],
    language: Language,
) -> Question | None:
    """The question before, about somebody or something else: "and B?", "and 3 times as much?"."""
    if before.kind in ("pair", "because", "presupposed") and others:
        return Question("contrastive", others, subject=others)
    if before.kind not in intents()["repeated"]:
        return None
    if before.kind == "what_if":
        bare = next((t.number for t in reversed(tokens) if t.number is not None and "%" not in t.word), None)
        factor = factor_in(tokens, language)
        factor = bare if factor is None else factor
        if now.component is None and factor is None:
            return None
        names = [now.component] if now.component else list(before.factors)
        known = next(iter(before.factors.values()))
        return Question("what_if", [], names[0], dict.fromkeys(names, known if factor is None else factor))
    if about and (others or before.kind in ABOUT_ALL):
        kept = about if before.kind in ABOUT_ALL else others
        return replace(before, about=kept, component=now.component or before.component, subject=kept, strange=[])
    if now.component and before.kind in ("component_of", "meaning", "difference", "turn"):
        return replace(before, component=now.component, strange=[])
    return None


def distinct(things: Sequence[Candidate]) -> list[Candidate]:
    """The things, each once."""
    return [thing for i, thing in enumerate(things) if not any(thing is known for known in things[:i])]
