"""Secrets in texts, whole and in pieces."""

from __future__ import annotations

import base64
import html
import itertools
import json
from urllib.parse import quote, quote_plus

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xqmap.explanations.dialogue.masking import Mask, secrets_of

KEY = "sk-A1b2C3d4/E5&f6"
_FORMS = (
    KEY,
    quote(KEY, safe=""),
    quote(KEY, safe="").lower(),
    quote_plus(KEY),
    html.escape(KEY),
    json.dumps(KEY)[1:-1],
)


@given(
    st.text(max_size=20),
    st.sampled_from([form for form in _FORMS if form != quote(KEY, safe="").lower()]),
    st.text(max_size=20),
    st.lists(st.integers(0, 60), max_size=5),
)
def test_a_secret_is_found_however_it_is_written_and_cut(before: str, form: str, after: str, cuts: list[int]) -> None:
    text = before + form + after
    edges = [0, *sorted(min(cut, len(text)) for cut in cuts), len(text)]
    pieces = [text[start:end] for start, end in itertools.pairwise(edges)]
    mask = Mask([KEY])
    for said in (mask(text), "".join(mask.stream(pieces))):
        assert "***" in said
        assert not any(form[: len(form) // 2 + 1] in said for form in _FORMS)


@given(st.lists(st.text("sk-A1b", max_size=6)))
def test_a_text_without_secrets_stays_as_it_is(pieces: list[str]) -> None:
    text = "".join(pieces)
    assert Mask([KEY])(text) == "".join(Mask([KEY]).stream(pieces)) == text


@pytest.mark.parametrize(
    ("text", "masked"),
    [
        ("wrong key sk-A1b2C3d4/E5****", "wrong key *******"),
        ("wrong key sk-A1...&f6", "wrong key sk-A1...&f6"),
        ("the keys are sk-A1b2C3d4/E5&f6 and sk-A1b2C3d4/E5&f6.", "the keys are *** and ***."),
        ("the word pass, but not passport or compass", "the word ***, but not passport or compass"),
        ("x marks the spot", "x marks the spot"),
    ],
)
def test_parts_of_a_secret(text: str, masked: str) -> None:
    assert Mask([KEY, "pass", "x", "", "no text: \udcff"])(text) == masked


def test_what_an_address_must_not_tell() -> None:
    address = "http://me:p%40ss/w?rd@host:80/v1?api-key=abcdefgh&page=2"
    mask = Mask(secrets_of(address))
    assert mask(address) == "http://***@host:80/v1?api-key=***&page=2"
    assert "p@ss/w?rd" not in mask("p@ss/w?rd is wrong")
    basic = base64.b64encode(b"me:p@ss/w?rd").decode()
    assert basic.rstrip("=") not in mask(f"Authorization: Basic {basic}")
    assert secrets_of("http://token12345@host") == ["token12345"]
    assert secrets_of("http://localhost:11434/v1") == secrets_of(None) == []
