"""What the measured costs are weighed with."""

from __future__ import annotations

from collections.abc import Callable

from omegaconf import DictConfig

from xqmap.benchmarks.speed import due


def test_the_longer_a_choice_is_kept_the_fewer_are_due(toy_config: Callable[..., DictConfig]) -> None:
    cfg = toy_config("trainer=default")
    shares = [due(cfg, period) for period in (1, 2, 100, 10**6)]
    assert shares[0] == 1
    assert shares == sorted(shares, reverse=True)
    # For ever: each of 1000 transitions once, of 2000 batches of 32; twice where it is drawn twice at first.
    assert 0.9 * 1000 / 64_000 < shares[-1] < 1.1 * 1000 / 64_000
