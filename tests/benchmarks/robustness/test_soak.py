"""A process left running keeps what it takes, and one that does not is found out; the benchmarks count what they
did.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hydra import initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from tests.toy import ToyTask
from xqmap.benchmarks.robustness import suite
from xqmap.benchmarks.robustness.soak import soak
from xqmap.config import plugins

pytestmark = [
    pytest.mark.sim,
]
KEPT = ("files", "devices", "threads", "processes")


def test_a_world_that_lets_go_of_everything_is_flat(toy_config: Callable[..., DictConfig]) -> None:
    result = soak(toy_config(), OmegaConf.create(), 60)
    assert result["decisions"] == 60
    assert result["growth"] < 0.05
    assert all(result[f"{when}leaked_{name}"] == 0 for name in KEPT for when in ("", "reopened_"))


def test_a_world_that_keeps_memory_and_files_is_found_out(
    toy_config: Callable[..., DictConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[Any] = []
    step = ToyTask.step

    def leaking(self: ToyTask, action: np.ndarray) -> Any:
        # Pages of its own: of memory that other tests gave back the process could take what it has already.
        pages = mmap.mmap(-1, 1 << 23)
        pages.write(bytes([1]) * (1 << 23))
        kept.append((pages, open(__file__)))  # noqa: SIM115
        return step(self, action)

    monkeypatch.setattr(ToyTask, "step", leaking)
    result = soak(toy_config(), OmegaConf.create(), 60)
    for pages, file in kept:
        pages.close()
        file.close()
    assert result["growth"] > 0.05
    assert result["leaked_files"] == 60 - 1 - 12


def test_fuzzing_counts_every_case(toy_config: Callable[..., DictConfig]) -> None:
    cfg = toy_config()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        result = suite.fuzzed(cfg, OmegaConf.create(), 20)
    parts = ("decisions", "run_directories", "reports", "overrides")
    assert result["cases"] == sum(result[f"{part}_cases"] for part in parts) == 20
    assert result["crashes"] == 0
    assert 0 < result["refused"] <= 20
