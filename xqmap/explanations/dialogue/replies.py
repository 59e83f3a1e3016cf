"""What servers that speak OpenAI's protocol send, also those that speak it with an accent: the text of an answer, or
why there is none.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from html import unescape
from typing import Any

# Characters that a line of an answer, and what is no answer, may have; and how many of the latter are looked at.
_LONGEST, _READ = 1_000_000, 10_000
_TAG = r"[<\[]\s*{}(?:think|thinking|thought|reasoning)\s*[>\]]"
_OPENS, _CLOSES = (re.compile(_TAG.format(slash), re.IGNORECASE) for slash in ("", r"/\s*"))
# What may become one of these tags.
_BEGUN = re.compile(r"[<\[][\s/a-z]{0,16}$", re.IGNORECASE)


class Unanswered(Exception):
    """The model gave no usable answer; the message says why in one line."""


def answer(pieces: Iterable[str]) -> Iterator[str]:
    """The text of an answer, piece by piece, from the body of a response: a stream of events, or one JSON object.

    Raises:
        Unanswered: if it is something else, or breaks off; the message tells what the server said.
    """
    other: list[str] = []
    ended, said = "", False
    for event in _events(pieces, other):
        if event == "[DONE]":
            ended = ended or "stop"
            break
        text, end = _read(event)
        ended = end or ended
        if text:
            said = True
            yield text
    if other and not (said and ended):
        # No event, or something after the last: JSON that holds an answer or an error, a web page, a line of text.
        text, end = _read("\n".join(other), whole=True)
        said, ended = said or bool(text), end or "stop"
        yield text
    if not ended:
        raise Unanswered("the model's answer broke off: the server closed the connection before its end")
    if not said:
        hint = ": llm.max_tokens was used up before it began" if ended == "length" else ""
        raise Unanswered(f"the model's answer was empty (finish_reason {ended}{hint})")


def without_thoughts(pieces: Iterable[str]) -> Iterator[str]:
    """A text without what stands between ``<think>`` and ``</think>``, or after a ``<think>`` that nothing closes."""
    held, thinking = "", False
    for piece in pieces:
        held += piece
        while found := (_CLOSES if thinking else _OPENS).search(held):
            if not thinking and found.start():
                yield held[: found.start()]
            held, thinking = held[found.end() :], not thinking
        begun = _BEGUN.search(held)
        cut = begun.start() if begun else len(held)
        if cut and not thinking:
            yield held[:cut]
        held = held[cut:]
    if held and not thinking:
        yield held


def after_thoughts(text: str) -> str:
    """What follows the last ``</think>``: some models' thoughts begin without a ``<think>``."""
    return _CLOSES.split(text)[-1].strip()


def reason(body: Any) -> str:
    """What a server gives as the cause of a failure, in one line: out of its JSON, its web page or its text."""
    if isinstance(body, str):
        body = body[:_READ]
        try:
            body = json.loads(body)
        except (ValueError, RecursionError):
            title = re.search(r"<title[^>]*>(.*?)</title>", body, re.IGNORECASE | re.DOTALL)
            body = unescape(title.group(1) if title else re.sub(r"<[^>]*>", " ", body))
    while isinstance(body, dict):
        body = next((body[key] for key in ("error", "message", "detail", "msg") if body.get(key)), json.dumps(body))
    return " ".join((body if isinstance(body, str) else json.dumps(body)).split()) or "nothing"


def _events(pieces: Iterable[str], other: list[str]) -> Iterator[str]:
    """The data of each server-sent event, which is one line in this protocol; lines that are none of an event go to
    ``other``.
    """
    length = 0
    for line in _lines(pieces):
        field, _, value = line.partition(":")
        if field == "data":
            yield value.strip()
        elif line and field not in ("", "event", "id", "retry"):
            # llama.cpp has "error:" where others have "data:".
            other.append(value if field == "error" else line)
            length += len(line)
            if length > _LONGEST:
                raise Unanswered(f"the server sent no answer, but more than {_LONGEST} characters of something else")


def _lines(pieces: Iterable[str]) -> Iterator[str]:
    held = ""
    for piece in pieces:
        *whole, held = (held + piece).split("\n")
        yield from (line.removesuffix("\r") for line in whole)
        if len(held) > _LONGEST:
            raise Unanswered(f"the model's answer was malformed: a line of more than {_LONGEST} characters")
    yield held


def _read(content: str, whole: bool = False) -> tuple[str, str]:
    """The text in one event, or in what a server sent as a whole, and why the answer ends there, if it does."""
    try:
        chunk = json.loads(content)
    except (ValueError, RecursionError):
        chunk = None
    if not isinstance(chunk, dict) or (whole and not {"choices", "error"} & chunk.keys()):
        is_none = "the server sent no answer (is llm.base_url right?), but" if whole else "the answer was malformed"
        raise Unanswered(f"{is_none}: {reason(content)}")
    choices = chunk.get("choices")
    choice = choices[0] if isinstance(choices, list) and choices and isinstance(choices[0], dict) else {}
    told = choice.get("error") or chunk.get("error")
    if told or ("choices" not in chunk and not chunk.keys().isdisjoint(("message", "detail", "error_code"))):
        raise Unanswered(f"the model's server broke off: {reason(told or chunk)}")
    message = choice.get("delta") or choice.get("message") or {}
    said = message.get("content") if isinstance(message, dict) else message
    return _text(choice.get("text") if said is None else said), str(choice.get("finish_reason") or "")


def _text(content: Any) -> str:
    """The words of a content: a text, a number, a dict, or a list of these, without parts that are thoughts."""
    if isinstance(content, list):
        return "".join(map(_text, content))
    if isinstance(content, dict):
        thought = re.search("think|reason", str(content.get("type")), re.IGNORECASE)
        named = next((content[key] for key in ("text", "content", "value") if key in content), None)
        return "" if thought else _text(named)
    return "" if content is None else str(content)
