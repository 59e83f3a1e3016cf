"""Rates and their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats


def wilson(correct: int, choices: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a proportion (Wilson, 1927), for one policy's independent choices."""
    if choices == 0:
        return 0.0, 1.0
    low, high = stats.binomtest(correct, choices).proportion_ci(0.95, method="wilson")
    return float(low), float(high)


def success(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Correct choices over runs: ``mean`` and ``std`` of the runs' rates, all ``choices``, and their 95 % interval
    ``ci95``.

    Args:
        runs: one dictionary per evaluation seed, with ``choices`` and ``correct``.
    """
    rates = [run["correct"] / run["choices"] for run in runs if run["choices"]]
    choices, correct = sum(run["choices"] for run in runs), sum(run["correct"] for run in runs)
    mean = sum(rates) / len(rates) if rates else float("nan")
    variance = sum((rate - mean) ** 2 for rate in rates) / (len(rates) - 1) if len(rates) > 1 else 0.0
    return {"mean": mean, "std": math.sqrt(variance), "choices": choices, "ci95": list(wilson(correct, choices))}


def bootstrap(rates: Sequence[float], resamples: int = 10_000) -> tuple[float, float]:
    """The 95 % percentile interval of the mean when trainings, not choices, are drawn anew (Efron, 1979).

    Args:
        rates: one per training seed.
        resamples: how many sets of trainings to draw; the draws are the same at every call.
    """
    draws = {"n_resamples": resamples, "rng": np.random.default_rng(0)}
    low, high = stats.bootstrap((rates,), np.mean, method="percentile", **draws).confidence_interval
    return float(low), float(high)
