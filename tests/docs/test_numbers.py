"""Numbers on the pages are those of the files that they came from."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from tests.documents import PAGES, README, ROOT
from xqmap.evaluation import results, tables

NAMES = {"xqmap": "**X-QMap**", "qlearning": "normal Q-learning", "hra": "HRA"}


@pytest.fixture(scope="module")
def rows() -> list[results.Row]:
    return results.table(results.collect(ROOT / "docs" / "paper")[0], results.paper_figures())


def _percent(row: results.Row) -> str:
    return tables.percent(row.mean)


def test_the_papers_table(rows: list[results.Row]) -> None:
    measured = {
        (row.task, NAMES.get(row.name, row.name)): [
            *(_percent(row), tables.percent(row.std), tables.interval(*row.ci95)),
            *(str(row.choices), f"{row.regret:.3f}", row.paper),
        ]
        for row in rows
        if not row.sheet
    }
    told = {(task, method): rest for task, method, *rest in PAGES["results"].table("task") if len(rest) == 6}
    assert told == measured


def test_other_scenes(rows: list[results.Row]) -> None:
    found = {(row.task, row.sheet, row.name): row for row in rows}
    told = [row for row in PAGES["results"].table("task") if ": " in row[1]]
    assert len(told) == 9
    for task, sheet, ours, plain, random, choices in told:
        key = task, sheet.split(":")[0]
        for text, name in ((ours, "xqmap"), (plain, "qlearning")):
            row = found[*key, name]
            assert text == f"{_percent(row)} ({tables.interval(*row.ci95)})"
            assert choices == str(row.choices)
        assert random == _percent(found[*key, "random object"])


def test_the_readmes_four(rows: list[results.Row]) -> None:
    found = {(row.task, row.sheet, row.name): _percent(row) for row in rows}
    for task, sheet in (("landing", "large"), ("grasping", "")):
        (told,) = [row for row in README.table("task") if row[0].startswith(task)]
        assert told[1:4] == [found[task, sheet, name] for name in ("xqmap", "qlearning", "random object")]
    assert found["grasping", "noise", "xqmap"] in README.text


def test_the_table_of_every_row_is_what_the_report_prints(rows: list[results.Row]) -> None:
    def lines(text: str) -> list[str]:
        return sorted(re.sub(r"\s+", " ", line) for line in text.splitlines())

    assert lines((ROOT / "docs" / "paper" / "table.md").read_text()) == lines(tables.markdown(rows))


def _content(*place: str) -> Any:
    return json.loads(ROOT.joinpath(*place).read_text())


def test_the_agents_that_ship() -> None:
    for task, told in (("landing", "298 of 300 views"), ("grasping", "311 of 311")):
        runs = _content("xqmap", "pretrained", task, "evaluation.json")["runs"]
        correct, choices = (sum(run[name] for run in runs) for name in ("correct", "choices"))
        assert told.startswith(f"{correct} of {choices}")
        assert told in " ".join(PAGES["results"].text.split())


def test_the_agent_with_a_future() -> None:
    found = _content("xqmap", "pretrained", "foresight", "evaluation.json")
    own = found | {"mean": found["success"]["mean"]}
    told = PAGES["results"].table("who chooses")
    for row, measured in zip(told, (own, found["controls"]["out of context"]), strict=True):
        shares = measured["optimal"]["mean"], measured["return_ratio"], measured["mean"]
        assert row[1:] == [tables.percent(share) for share in shares]
    for row, name in zip(PAGES["results"].table("bars"), ("shape", "color"), strict=True):
        exact = found["calibration"]["exact"][name]
        numbers = [
            f"{exact['bias']:+.2f}".replace("-", "−"),
            f"{exact['mae']:.2f}",
            tables.percent(exact["sign_accuracy"]),
        ]
        assert row[0].startswith(name) and row[1:] == numbers


def test_the_contrast() -> None:
    told = PAGES["results"].table("bars of")
    assert [row[:2] for row in told] == [[who, part] for who in ("X-QMap", "HRA") for part in ("shape", "color")]
    for who, part, bias, error, rank, sign in told:
        folder = "method-xqmap" if who == "X-QMap" else "method-hra"
        exact = _content("docs", "contrast", folder, "evaluation.json")["calibration"]["exact"][part]
        measured = [f"{exact['bias']:+.2f}", f"{exact['mae']:.2f}", f"{exact['rank_correlation']:.2f}"]
        assert [bias, error, rank] == [number.replace("-", "−") for number in measured]
        share, pairs = sign.replace(",", "").split(" % of ")
        assert float(share) == pytest.approx(100 * exact["sign_accuracy"], abs=0.05)
        assert int(pairs) == exact["pairs"]


def test_an_update() -> None:
    update = _content("docs", "bench", "update.json")["update"]
    first, second, third = PAGES["speed"].table("")[-3:]
    for row, gamma in ((first, "gamma=0"), (second, "gamma=0.9")):
        taken = [update[f"seconds/{name}/{gamma}"] for name in ("dense", "fp32", "bf16")]
        assert row[1:4] == [f"{taken[0]:.2f} s", f"{taken[1]:.3f} s", f"{taken[2]:.3f} s"]
    ratios = [update[f"ratio/bf16/{name}"] for name in ("gamma=0", "gamma=0.9, choice_period=1")]
    assert [first[4], second[4]] == [f"{ratios[0]:.0f} ×", f"{ratios[1]:.1f} ×"]
    assert third[4] == f"{update['ratio/bf16/gamma=0.9, choice_period=100']:.1f} ×"
    assert f"{100 * update['share_due/choice_period=100']:.0f} %" in PAGES["speed"].text
