"""wandb's files are read as wandb's own command reads them, without starting it."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.conftest import toy_settings
from tests.evaluation.test_results import write_run
from xqmap.evaluation import results
from xqmap.reports import offline
from xqmap.reports.runs import gather
from xqmap.trainers.logger import Log

ROWS = 200


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's file of several blocks, with gaps and a picture."""
    folder = tmp_path_factory.mktemp("logged")
    Image.new("RGB", (8, 8)).save(folder / "picture.png")
    log = Log(folder, toy_settings("logger.mode=offline"), ["frames", "success", "loss/left", "loss/right"])
    for i in range(1, ROWS + 1):
        log.row({"frames": 4 * i, "success": i / 7, "loss/left": 1 / i if i % 3 else math.nan})
    log.picture("qmaps", folder / "picture.png", 4 * ROWS)
    log.close()
    return next(folder.rglob("offline-run-*/*.wandb"))


def test_it_says_what_wandbs_own_command_says(logged: Path) -> None:
    command = [sys.executable, "-m", "wandb", "leet", "inspect", "--json", str(logged)]
    records = [json.loads(line) for line in subprocess.check_output(command, text=True, timeout=120).splitlines()]
    ours = offline.read(logged)
    history = [record["history"]["item"] for record in records if record["type"] == "history"]
    assert len(history) == len(ours.columns["frames"]) > ROWS - 1
    for name, values in ours.columns.items():
        np.testing.assert_equal(values, [row.get(name, math.nan) for row in history])
    assert ours.config == next(record["run"]["config"]["update"] for record in records if record["type"] == "run")
    theirs = next(record["environment"] for record in records if record["type"] == "environment")
    assert {"host", "os", "python", "program", "started_at"} <= set(ours.environment) <= set(theirs)
    theirs["git"] = {"commit": theirs.get("git", {}).get("commit")}
    assert ours.environment == {name: theirs[name] for name in ours.environment}
    assert list(ours.pictures) == [4 * ROWS] and next(iter(ours.pictures.values())).is_file()
    assert (ours.exit_code, ours.trouble) == (0, "")


def test_no_process_is_started_and_no_file_is_read_twice(
    logged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in range(3):
        run = write_run(tmp_path, f"run{seed}", 9, seed=seed)
        (run / ".hydra" / "overrides.yaml").write_text("- +task=landing")
        (run / "metrics.csv").write_text("frames\n4\n")
        (run / "wandb" / "offline-run-1").mkdir(parents=True)
        (run / "wandb" / "offline-run-1" / "run-1.wandb").write_bytes(logged.read_bytes())
    opened, really = Counter[str](), os.open

    def counted(path: Any, *arguments: Any, **named: Any) -> int:
        opened[str(path)] += Path(path).is_file()
        return really(path, *arguments, **named)

    def refused(*arguments: Any, **named: Any) -> None:
        raise AssertionError("a process was started")

    monkeypatch.setattr(os, "open", counted)
    monkeypatch.setattr(subprocess, "Popen", refused)
    runs, left_out = gather(tmp_path, results.collect(tmp_path)[0])
    assert (len(runs), left_out) == (3, {})
    assert all(len(run.columns["frames"]) >= ROWS for run in runs)
    once = {name: count for name, count in opened.items() if count}
    assert len(once) == 3 * len(("config", "overrides", "metrics", "evaluation", "wandb"))
    assert set(once.values()) == {1}


@pytest.mark.parametrize(
    ("damage", "trouble"),
    [
        (lambda content: b"", "incomplete"),
        (lambda content: content[:3], "incomplete"),
        (lambda content: content[: len(content) // 2], "incomplete"),
        (lambda content: b"PK" + content, "not a file of wandb's"),
        (lambda content: content[:40_000] + b"xxxx" + content[40_004:], "damaged"),
        (lambda content: content[:7] + bytes(len(content)), "damaged"),
    ],
)
def test_a_damaged_file_is_read_as_far_as_it_can_be(
    damage: Callable[[bytes], bytes], trouble: str, logged: Path, tmp_path: Path
) -> None:
    (tmp_path / "a.wandb").write_bytes(damage(logged.read_bytes()))
    found = offline.read(tmp_path / "a.wandb")
    assert trouble in found.trouble
    whole = offline.read(logged).columns["frames"]
    assert set(found.columns.get("frames", [])) <= set(whole)
    if trouble == "damaged" and "frames" in found.columns:
        # What follows the damaged block is there.
        assert found.columns["frames"][-1] == whole[-1] and len(found.columns["frames"]) < len(whole)


def test_more_numbers_than_a_training_logs_are_not_kept(logged: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offline, "MOST_NUMBERS", 100)
    found = offline.read(logged)
    assert "more than the 100 numbers" in found.trouble and not found.columns


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.wandb")
    assert offline.read(tmp_path / "a.wandb").trouble == "not a regular file"
