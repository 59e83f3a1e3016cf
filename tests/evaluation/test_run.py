"""An evaluation of a run: what it prints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from xqmap.evaluation.run import evaluate_run
from xqmap.runs.run import load_run
from xqmap.trainers.callbacks import Checkpoints, make_trainer


@pytest.mark.sim
def test_a_strangers_names_move_no_cursor(
    toy_config: Callable[..., DictConfig], run_directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = toy_config("evaluation.seeds=[0]", "evaluation.choices=2")
    run_directory.mkdir()
    trainer = make_trainer(cfg, run_directory)
    Checkpoints().save(trainer)
    trainer.close()
    run = load_run(run_directory)
    # A file that bears such a name is not read; what prints does not rely on that.
    run.cfg.method.name = "\x1b[2Jx\x1b]0;title\x07qmap\x9b"
    evaluate_run(run, cfg.evaluation, run_directory / "evaluation.json")
    said = capsys.readouterr().out
    assert "x ]0;title qmap" in said
    assert said.replace("\n", "").isprintable()
