"""An evaluation of a run: what it prints."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from xqmap.evaluation.run import evaluate_run
from xqmap.trainers.trainer import Trainer


@pytest.mark.sim
@pytest.mark.usefixtures("trust_toy")
def test_a_strangers_names_move_no_cursor(
    toy_config: Callable[..., DictConfig], run_directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cfg = toy_config("evaluation.seeds=[0]", "evaluation.choices=2")
    cfg.method.name = "\x1b[2Jx\x1b]0;title\x07qmap\x9b"
    run_directory.mkdir()
    trainer = Trainer(cfg, run_directory)
    trainer.save()
    trainer.close()
    evaluate_run(run_directory, cfg.evaluation, run_directory / "evaluation.json")
    said = capsys.readouterr().out
    assert "x ]0;title qmap" in said
    assert said.replace("\n", "").isprintable()
