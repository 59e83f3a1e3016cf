"""Files of questions: what is wrong in one is refused by its place, and answers are held against what is expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.talks import dialogue
from xqmap.errors import UserError
from xqmap.explanations.dialogue import scoring
from xqmap.explanations.dialogue.scoring import Expectation


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("- {ask: Why, says: 1}", "entry 1 says"),
        ("- {ask: Why, says: []}", "entry 1 says"),
        ("- {ask: Why, says: null}", "entry 1 says"),
        ("- {ask: Why, says: word}", "entry 1 says"),
        ("- {ask: Why}\n- {ask: Why, says: [a, 1.96]}", r"entry 2 says\[1\]"),
        ("- {ask: Why, says: [' ']}", r"entry 1 says\[0\]"),
        ("- {ask: Why, says: [yes]}", r"entry 1 says\[0\]"),
        ("- {ask: Why, says: {a: b}}", "entry 1 says"),
        ("- {ask: Why, say: [a]}", "entry 1 say:"),
        ("- {ask: Why, kind: shalow}", "entry 1 kind: .*shalow.*shallow"),
        ("- {ask: Why, kind: 1}", "entry 1 kind"),
        ("- {ask: 1}", "entry 1 ask"),
        ("- {ask: ''}", "entry 1 ask"),
        ("- {kind: shallow}", "entry 1 ask"),
        ("- Why", "entry 1:"),
        ("- [Why]", "entry 1:"),
        ("[]", "list"),
        ("ask: Why", "list"),
        ("- {ask: Why, ask: How}", "cannot be read"),
        ("- {ask: 'Why", "cannot be read"),
        ("[" * 5000, "cannot be read"),
        ("7", "cannot be read|list"),
    ],
)
def test_a_file_that_is_wrong_is_refused_by_its_place(content: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "questions.yaml"
    path.write_text(content)
    with pytest.raises(UserError, match=rf"(?s)^questions={path}.*{told}") as caught:
        scoring.read(path)
    assert len(str(caught.value).splitlines()) == 1


def test_an_answer_is_held_against_what_is_expected_of_it() -> None:
    talk = dialogue()
    exchange = talk.ask("Why?")
    assert scoring.as_expected(exchange, Expectation(ask="Why?"))
    assert scoring.as_expected(exchange, Expectation(ask="Why?", kind="shallow", says=["BLUE", "1.96"]))
    assert not scoring.as_expected(exchange, Expectation(ask="Why?", kind="sure"))
    assert not scoring.as_expected(exchange, Expectation(ask="Why?", says=["blue", "green"]))
    exchange.source = "llm"
    assert scoring.as_expected(exchange, Expectation(ask="Why?", kind="sure"))


def test_the_report_tells_what_fell_short() -> None:
    talk = dialogue()
    expectations = [
        Expectation(ask="Why?", kind="shallow"),
        Expectation(ask="Why not A?", says=["nothing like it"]),
        Expectation(ask="How sure are you?"),
        Expectation(ask="What do you see?"),
    ]
    exchanges = [talk.ask(expected.ask) for expected in expectations]
    exchanges[2].ungrounded, exchanges[3].failure = ["7.77"], "no server answers"
    said = scoring.report(exchanges, expectations)
    assert "Why not A?\n" in said and "(not what was expected)" in said
    assert "(not in the decision: 7.77)" in said and "Why?\n" not in said
    assert "1 answers are the templates', not the model's (no server answers)" in said
    assert said.endswith("4 questions: 75.0% of the answers grounded, 75.0% as expected")
