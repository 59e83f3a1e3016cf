"""Python and JSON on the pages run as printed."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import pytest

import xqmap
from tests.documents import PAGES, README
from tests.explanations.test_decision import made
from xqmap import api
from xqmap.explanations import Decision

TEN_LINES = textwrap.dedent(str(api.__doc__).split("\n\n", 1)[1]).strip()


def test_the_ten_lines_are_those_that_are_run() -> None:
    # tests/test_api.py runs them.
    assert PAGES["python"].python("env.play(").strip() == TEN_LINES
    assert README.python("env.play(").strip() == TEN_LINES


def test_what_import_xqmap_offers_is_listed() -> None:
    named = [re.match(r"xqmap\.(\w+)\(", row[0]) for row in PAGES["python"].table("function")]
    assert sorted(found[1] for found in named if found) == sorted(xqmap.__all__)


def test_a_saved_decision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = PAGES["python"].python("Decision.load")
    place = re.search(r'Decision\.load\("([^"]*)"\)', example)
    assert place is not None
    made(Selected=(0.93, 1.0), A=(1.0, 0.0), B=(0.02, 1.02)).save(tmp_path / place.group(1))
    known: dict[str, object] = {}
    monkeypatch.chdir(tmp_path)
    exec(example, known)
    assert (tmp_path / "bars.png").stat().st_size > 5000
    assert isinstance(known["decision"], Decision)


def test_settings(capsys: pytest.CaptureFixture[str]) -> None:
    example = PAGES["python"].python("xqmap.settings")
    exec(example, {})
    promised = re.search(r"# (100 .*)$", example, re.MULTILINE)
    assert promised is not None
    assert capsys.readouterr().out.strip() == promised[1]


def test_a_network_of_ones_own(capsys: pytest.CaptureFixture[str]) -> None:
    page = PAGES["own_networks"]
    exec(page.python("DecomposedDQNLoss("), {})
    printed = capsys.readouterr().out
    assert [
        name for name in ("loss_safety", "loss_speed", "td_error_speed", "value_safety") if name not in printed
    ] == []


def test_values_of_any_agent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(PAGES["own_networks"].python("Decision.from_values("), {})
    assert "rather than the step left (A)" in capsys.readouterr().out
    assert Decision.load(tmp_path / "choice" / "decision.json").selected.object == "step right"


def test_the_decision_of_another_program(tmp_path: Path) -> None:
    (content,) = [block.text for block in PAGES["own_networks"].blocks if block.language == "json"]
    (tmp_path / "decision.json").write_text(content)
    decision = Decision.load(tmp_path / "decision.json")
    assert "bay 3" in decision.why()
    assert "bay 1" in decision.ask("Why not A?")


@pytest.mark.sim
def test_train_then_ask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    example = PAGES["python"].python('trainer="smoke"').replace('"landing"', '"toy"')
    exec(example.replace('trainer="smoke"', 'trainer="smoke", mode="disabled"'), {})
    assert "I chose" in capsys.readouterr().out
    assert (tmp_path / "runs" / "mine" / "checkpoint" / "policy.safetensors").exists()
