"""Intervals that are right for a proportion."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from xqmap.evaluation.statistics import bootstrap, success, wilson


def test_wilson_against_published_values() -> None:
    # Newcombe 1998, table I: 81 of 263 and 0 of 20.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)


@given(st.integers(0, 500), st.integers(1, 500))
def test_interval_holds_the_rate(correct: int, choices: int) -> None:
    correct = min(correct, choices)
    low, high = wilson(correct, choices)
    assert 0 <= low <= correct / choices + 1e-12
    assert correct / choices - 1e-12 <= high <= 1


def test_success_over_runs() -> None:
    row = success([{"choices": 1, "correct": 1}] * 9 + [{"choices": 1, "correct": 0}])
    assert row["mean"] == pytest.approx(0.9)
    assert row["std"] == pytest.approx(0.3162, abs=1e-4)
    assert row["choices"] == 10


def test_bootstrap_against_all_resamples() -> None:
    # Of three trainings, 27 equally likely resamples: the lowest mean has probability 1/27 > 2.5 %.
    assert bootstrap([0.2, 0.8, 1.0]) == pytest.approx((0.2, 1.0))
    rates = [i / 19 for i in range(20)]
    spread = 1.96 * (sum((r - 0.5) ** 2 for r in rates) / 20 / 20) ** 0.5
    assert bootstrap(rates) == pytest.approx((0.5 - spread, 0.5 + spread), abs=0.01)
