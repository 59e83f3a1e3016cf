"""Answers held against a file of questions and what is expected of each (``conf/explain/questions`` has some)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter, ValidationError, field_validator
from yaml import YAMLError

from xqmap.errors import UserError, brief
from xqmap.explanations.dialogue.answers import KINDS
from xqmap.explanations.dialogue.conversation import Exchange

_Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]


class Expectation(BaseModel):
    """A question and what is expected of its answer.

    Attributes:
        ask: the question.
        kind: how it is to be understood, one of ``answers.KINDS``; None expects nothing of that.
        says: texts that the answer holds, in small or capital letters.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    ask: _Text
    kind: _Text = ""
    says: list[_Text] = Field(default=[], min_length=1)

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in KINDS:
            raise ValueError(f"there is no kind {kind!r}, only {', '.join(KINDS)}")
        return kind


_ENTRIES = TypeAdapter(Annotated[list[Expectation], Field(min_length=1)])


def read(path: Path) -> list[Expectation]:
    """The questions of a file.

    Raises:
        UserError: naming the file, and the entry that is wrong.
    """
    try:
        return _ENTRIES.validate_python(OmegaConf.to_container(OmegaConf.load(path)))
    except ValidationError as error:
        first = error.errors()[0]
        number, *place = first["loc"] or (None,)
        entry = f", entry {number + 1}" if isinstance(number, int) else ""
        named = "".join(f"[{part}]" if isinstance(part, int) else f" {part}" for part in place)
        raise UserError(
            f"questions={path}{entry}{named}: {first['msg']} (a file of questions is a list of entries with ask, "
            "a text, and what is expected: kind, a text, and says, a list of texts)"
        ) from None
    except (OSError, OmegaConfBaseException, YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"questions={path} cannot be read ({brief(error)})") from None


def as_expected(exchange: Exchange, expected: Expectation) -> bool:
    """Whether an answer says all of ``says`` and, where it came from a template, the question was taken as ``kind``."""
    said = exchange.answer.lower()
    taken = exchange.source != "template" or exchange.kind == (expected.kind or exchange.kind)
    return taken and all(word.lower() in said for word in expected.says)


def report(exchanges: Sequence[Exchange], expectations: Sequence[Expectation]) -> str:
    """The answers that are not grounded or not as expected, and the shares of those that are."""
    lines, fitting = [], 0
    for exchange, expected in zip(exchanges, expectations, strict=True):
        fits = as_expected(exchange, expected)
        fitting += fits
        if exchange.ungrounded:
            lines.append(f"{_told(exchange)}\n  (not in the decision: {', '.join(exchange.ungrounded)})")
        elif not fits:
            lines.append(f"{_told(exchange)}\n  (not what was expected)")
    if failures := [exchange.failure for exchange in exchanges if exchange.failure]:
        lines.append(f"{len(failures)} answers are the templates', not the model's ({failures[0]})")
    count, grounded = len(exchanges), sum(not exchange.ungrounded for exchange in exchanges)
    shares = f"{grounded / count:.1%} of the answers grounded, {fitting / count:.1%} as expected"
    return "\n".join([*lines, f"{count} questions: {shares}"])


def _told(exchange: Exchange) -> str:
    return f"{exchange.question}\n  {exchange.answer}"
