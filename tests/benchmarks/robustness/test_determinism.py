"""The same seed in two processes: the same weights, the same table (it carries the weights' checksum), the same
pictures.
"""

from __future__ import annotations

import hashlib
import multiprocessing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from omegaconf import DictConfig, OmegaConf

from xqmap import explain
from xqmap.benchmarks.robustness import interruptions
from xqmap.config import schema
from xqmap.evaluation.run import evaluate_run
from xqmap.runs.run import load_run

pytestmark = [pytest.mark.sim]


def make(settings: dict[str, Any], directory: str) -> None:
    """A training, its evaluation and an explanation, in this process."""
    interruptions.attempt(settings, directory)
    place, cfg = Path(directory), schema.typed(OmegaConf.create(settings))
    run = load_run(place)
    evaluate_run(run, cfg.evaluation, place / "evaluation.json")
    see = OmegaConf.create({"_target_": "xqmap.explanations.perception.Simulator"})
    explain.write(run.episode(3, 1, see)[0], place / "figures" / "scene3")


def test_two_processes_make_the_same_of_the_same_seed(toy_config: Callable[..., DictConfig], tmp_path: Path) -> None:
    cfg = toy_config("trainer.frames=24", "trainer.warmup_frames=6", "trainer.picture_period=12")
    context = multiprocessing.get_context("forkserver")
    directories = [tmp_path / name for name in ("first", "second")]
    for directory in directories:
        process = context.Process(target=make, args=(OmegaConf.to_container(cfg, resolve=True), str(directory)))
        process.start()
        process.join()
        assert process.exitcode == 0
    first, second = (
        {
            str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in directory.rglob("*")
            if path.suffix in (".png", ".svg", ".txt", ".npz") or path.name in ("evaluation.json", "decision.json")
        }
        for directory in directories
    )
    assert first == second
    assert {Path(name).suffix for name in first} >= {".png", ".svg", ".json"}
