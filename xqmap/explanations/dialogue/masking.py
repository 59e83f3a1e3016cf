"""Keys and passwords stay where they are: what a person reads, or a file keeps, shows a mask in their place."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Iterable, Iterator
from itertools import takewhile
from urllib.parse import parse_qsl, quote, quote_plus, unquote

_MASK = "***"
# Shorter ones stand for a secret that there is not ("x"), and would be found in any text.
_SHORTEST = 4
# From here on a secret is masked within words, too, and where a text begins as it does.
_LONG = 8


def secrets_of(address: str | None) -> list[str]:
    """What an address may tell nobody: ``user:password``, or the token in its place, and the values of its query."""
    # Not by a parser of addresses: a password may be what makes this none.
    user, _, place = re.sub(r"^[a-z0-9+.-]*:?//", "", address or "", flags=re.IGNORECASE).rpartition("@")
    _, _, password = user.partition(":")
    query = place.partition("?")[2].partition("#")[0]
    return [text for text in (user, password, *(value for _, value in parse_qsl(query))) if text]


class Mask:
    """Replaces secrets in texts, however they were written: plain, for an address, for HTML or JSON, as Basic
    authentication. A text that holds at least the first half of a long secret shows no more of it.

    Args:
        secrets: keys, passwords, ``user:password``.
    """

    def __init__(self, secrets: Iterable[str]) -> None:
        plain = {form for secret in secrets for form in (secret, unquote(secret)) if len(form) >= _SHORTEST}
        forms = {form for secret in plain for form in _forms(secret)}
        self._forms = sorted(forms, key=len, reverse=True)
        begins = [
            re.escape(f[: max(_LONG, (len(f) + 1) // 2)])
            if len(f) >= _LONG
            else rf"(?<![^\W_]){re.escape(f)}(?![^\W_])"
            for f in self._forms
        ]
        self._begins = re.compile("|".join(begins) or "(?!)")

    def __call__(self, text: str) -> str:
        """The text without secrets."""
        parts, end = [], 0
        while found := self._begins.search(text, end):
            parts.append(text[end : found.start()])
            # As far as it goes on like any of the forms, which may begin alike.
            end = found.start() + max(_shared(text[found.start() :], form) for form in self._forms)
        return _MASK.join([*parts, text[end:]])

    def stream(self, pieces: Iterable[str]) -> Iterator[str]:
        """The same of a text that comes in pieces: what may be the beginning of a secret waits for the next one."""
        held = ""
        for piece in pieces:
            held += piece
            begun = max((_begun(held, form) for form in self._forms), default=0)
            if begun < len(held):
                yield self(held[: len(held) - begun])
                held = held[len(held) - begun :]
        if held:
            yield self(held)


def _forms(secret: str) -> set[str]:
    # Of bytes that are no text, the environment makes surrogates.
    coded, plus = (code(secret, safe="", errors="surrogatepass") for code in (quote, quote_plus))
    lower = re.sub("%[0-9A-F]{2}", lambda match: match.group().lower(), coded)
    basic = base64.b64encode(secret.encode(errors="surrogatepass")).decode().rstrip("=") if ":" in secret else secret
    return {secret, coded, lower, plus, html.escape(secret), json.dumps(secret)[1:-1], basic}


def _shared(text: str, form: str) -> int:
    """How many characters two texts begin with in common."""
    return len(list(takewhile(lambda pair: pair[0] == pair[1], zip(text, form, strict=False))))


def _begun(text: str, form: str) -> int:
    """How many of the last characters of ``text`` a secret may begin with."""
    most = min(len(text), len(form) - 1)
    return next((n for n in range(most, 0, -1) if form.startswith(text[-n:])), 0)
