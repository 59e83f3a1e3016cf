"""Decision files are read with care: what is wrong is named with its place, hostile text stays text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.views import plots
from xqmap.explanations.views.page import page

GOOD: dict[str, Any] = {
    "task": "landing",
    "components": ["flatness", "color"],
    "candidates": [
        {"label": "Selected", "object": "blue flat block", "values": {"flatness": 1.0, "color": 0.9}},
        {"label": "A", "object": "ground", "values": {"flatness": 1.0, "color": 0.1}},
    ],
}
BAD: list[tuple[str, str]] = [
    ("not json", "not JSON"),
    ("[]", "must hold a JSON object"),
    (json.dumps({k: v for k, v in GOOD.items() if k != "task"}), "task is missing"),
    (json.dumps(GOOD | {"candidates": []}), "candidates must be a list that is not empty"),
    (json.dumps(GOOD | {"components": ["a", "a"]}), "names one twice"),
    (json.dumps(GOOD | {"candidates": [GOOD["candidates"][1]]}), "none with the label 'Selected'"),
    (
        json.dumps(GOOD | {"candidates": GOOD["candidates"] + [GOOD["candidates"][1]]}),
        r"candidates\[2\].label repeats 'A'",
    ),
    (json.dumps(GOOD).replace('"color": 0.1', '"colour": 0.1'), r"candidates\[1\].values lacks the component 'color'"),
    (
        json.dumps(GOOD).replace('"color": 0.1', f'"color": 1{"0" * 400}'),
        r"candidates\[1\].values.color must be a finite number",
    ),
    (json.dumps(GOOD).replace('"color": 0.1', '"color": NaN'), r"candidates\[1\].values.color must be a finite number"),
    (json.dumps(GOOD).replace('"color": 0.1', '"color": "red"'), r"candidates\[1\].values.color must be a number"),
    (
        json.dumps(GOOD).replace('"color": 0.1', '"color": 1e300'),
        r"candidates\[1\].values.color must be a finite number of at most",
    ),
    (json.dumps(GOOD).replace('"ground"', '""'), r"candidates\[1\].object must be a text"),
    (json.dumps(GOOD).replace('"ground"', json.dumps("x" * 300)), r"candidates\[1\].object is longer"),
    ("[" * 100_000, "not JSON"),
]


@pytest.mark.parametrize(("content", "why"), BAD, ids=range(len(BAD)))
def test_bad_files_are_refused_with_the_place(content: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "decision.json"
    path.write_text(content)
    with pytest.raises(UserError, match=why) as told:
        Decision.load(path)
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


def test_a_minimal_file_is_enough_and_hostile_text_stays_text(tmp_path: Path) -> None:
    hostile = "<script>alert(1)</script>\u001b[2J $\\frac{1}{0}$ {weights}"
    content = json.dumps(GOOD).replace('"ground"', json.dumps(hostile))
    path = tmp_path / "decision.json"
    path.write_text(content)
    decision = Decision.load(path)
    html = page([decision])
    assert "<script" not in html
    assert "\u001b" not in decision["A"].object
    plots.save(plots.bars(decision), tmp_path / "bars")
    assert (tmp_path / "bars.png").stat().st_size > 5000


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(),
        lambda x: st.lists(x) | st.dictionaries(st.text(), x),
        max_leaves=20,
    )
)
@settings(max_examples=150)
def test_any_json_is_either_read_or_refused_in_one_line(content: Any) -> None:
    from xqmap.explanations.reading import parse

    for wrapped in (
        content,
        GOOD | {"candidates": content},
        GOOD | {"components": content},
        GOOD | {"noise": content, "step": content},
    ):
        try:
            parse(wrapped, "file")
        except UserError as error:
            assert "\n" not in str(error)
