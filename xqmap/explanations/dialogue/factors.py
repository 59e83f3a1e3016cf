"""How many times as much each component counts in what a question supposes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xqmap.explanations.dialogue.language import Language, Token


def factors_in(
    tokens: Sequence[Token], named: Mapping[int, str], components: Sequence[str], language: Language
) -> dict[str, float]:
    """The factors by component: one clause at a time, so that two can change.

    Args:
        tokens: of the question.
        named: the component that is named at a token.
        components: all of the decision.
        language: of the question.
    """
    words = language.content
    cuts = [i for i, token in enumerate(tokens) if token.word == "," or token.word in words["clauses"]]
    factors: dict[str, float] = {}
    for start, end in zip([0, *[cut + 1 for cut in cuts]], [*cuts, len(tokens)], strict=True):
        clause, here = tokens[start:end], [named[i] for i in range(start, end) if i in named]
        if not here:
            continue
        factor = factor_in(clause, language)
        if factor is None and any(span.concept == "only" for span in language.concepts(clause)):
            return {other: 0.0 for other in components if other not in here}
        if factor is not None:
            factors[here[0]] = factor
    if not factors and named and (factor := factor_in(tokens, language)) is not None:
        factors[named[min(named)]] = factor
    return factors


def factor_in(tokens: Sequence[Token], language: Language) -> float | None:
    """How many times as much something counts: "twice", "20% less", "3 times", "not"; None if nothing does."""
    words = language.content
    counts = {span.start for span in language.concepts(tokens) if span.concept in ("count", "factor_word")}
    for i, token in enumerate(tokens):
        after = [later.word for later in tokens[i + 1 : i + 3]]
        number = token.number
        if number is not None and ("%" in token.word or after[:1] == ["%"] or (after and after[0] in words["percent"])):
            share = number / 100
            rest = {later.word for later in tokens[i + 1 :]}
            if rest & set(words["more"]):
                return 1 + share
            return max(0.0, 1 - share) if rest & set(words["less"]) else share
        if number is None and token.word in words["numbers"]:
            number = float(words["numbers"].index(token.word)) if after and after[0] in words["times"] else None
        if number is not None and ((after and after[0] in words["times"]) or any(at < i for at in counts)):
            return number
    return next((value for value, _ in language.factors(tokens)), None)
