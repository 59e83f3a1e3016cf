"""The commands as a person calls them: mistakes give one clear line, a non-zero exit, and leave nothing behind."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


def call(module: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", f"xqmap.{module}", *arguments], cwd=cwd, capture_output=True, text=True, timeout=600)


MISTAKES = [
    ("train", [], "+task=landing"),
    ("train", ["+task=flying"], "task/flying"),
    ("train", ["+task=landing", "trainer.frames=-5"], "trainer.frames"),
    ("train", ["+task=landing", "loss.gamma=abc"], "loss.gamma"),
    ("train", ["+task=landing", "loss.gamma=1.5"], "loss.gamma"),
    ("train", ["+task=landing", "trainer.frams=5"], "frams"),
    ("train", ["+task=landing", "task.weights.shape=2"], "task.weights.shape"),
    ("train", ["+task=landing", "evaluation.seeds=[]"], "evaluation.seeds"),
    ("train", ["+task=landing", "hydra.run.dir=/proc/nowhere"], "/proc/nowhere"),
    ("train", ["resume=nowhere"], "nowhere"),
    ("train", ["resume=nowhere", "seed=3"], "resume"),
    ("evaluate", [], "run"),
    ("evaluate", ["run=nowhere"], "nowhere"),
    ("doctor", ["only=teeth"], "teeth"),
]


@pytest.mark.parametrize(("module", "arguments", "named"), MISTAKES, ids=lambda value: str(value))
def test_mistakes(module: str, arguments: list[str], named: str, tmp_path: Path) -> None:
    done = call(module, *arguments, cwd=tmp_path)
    assert done.returncode != 0
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    assert named in lines[0]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_doctor_finds_this_machine_fit(tmp_path: Path) -> None:
    done = call("doctor", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "ok  vulkan" in done.stdout
