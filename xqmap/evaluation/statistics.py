"""Rates and their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

# Two-sided 95 % of the normal distribution.
Z95 = 1.959963984540054


def wilson(correct: int, choices: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a proportion (Wilson, 1927), for one policy's independent choices."""
    if choices == 0:
        return 0.0, 1.0
    rate, z2 = correct / choices, Z95**2
    centre = (rate + z2 / (2 * choices)) / (1 + z2 / choices)
    half = Z95 / (1 + z2 / choices) * math.sqrt(rate * (1 - rate) / choices + z2 / (4 * choices**2))
    return max(0.0, centre - half), min(1.0, centre + half)


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
    values = np.asarray(rates, dtype=float)
    drawn = np.random.default_rng(0).integers(len(values), size=(resamples, len(values)))
    low, high = np.quantile(values[drawn].mean(1), [0.025, 0.975])
    return float(low), float(high)
