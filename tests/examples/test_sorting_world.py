"""The worked example as its reader would use it: its package and ours from wheels, in an environment of their own, in a
directory that holds a ``tasks.py`` and a ``conf/`` of the reader's.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.sim


def done(*command: str | Path, cwd: Path, **environment: str) -> str:
    """What a command prints; fails with what it complained of."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=kept | environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both packages, built as they would be released."""
    folder = tmp_path_factory.mktemp("wheels")
    parts = ("pyproject.toml", "README.md", "LICENSE", "conf", "tasks", "xqmap", "sorting_world")
    for source in (ROOT, ROOT / "examples" / "sorting_world"):
        copy = folder / f"{source.name}-source"
        copy.mkdir()
        for path in (source / part for part in parts):
            if path.is_dir():
                shutil.copytree(path, copy / path.name, ignore=shutil.ignore_patterns("__pycache__"))
            elif path.exists():
                shutil.copy(path, copy)
        done(sys.executable, "-m", "uv", "build", "--quiet", "--wheel", "--no-build-isolation", "--python",
             sys.executable, "--out-dir", folder, copy, cwd=folder)  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def environment(wheels: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment's Python, with the two packages; the libraries are those of this one."""
    folder = tmp_path_factory.mktemp("environment")
    done(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    python = folder / "venv" / "bin" / "python"
    done(sys.executable, "-m", "uv", "pip", "install", "--quiet", "--no-deps", "--offline", "--python", python,
         *wheels.glob("*.whl"), cwd=folder)  # fmt: skip
    place = done(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    # Below what is installed here, and without this environment's own .pth files.
    (Path(place) / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def test_the_wheel_brings_nothing_that_a_file_of_ones_own_could_hide(wheels: Path) -> None:
    wheel = next(wheels.glob("xqmap-*.whl"))
    top = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {name for name in top if not name.endswith(".dist-info")} == {"xqmap", "xqmap_tasks"}


def test_a_world_in_a_package_of_ones_own_is_checked_trained_explained_and_reported(
    environment: Path, tmp_path: Path
) -> None:
    (tmp_path / "tasks.py").write_text("raise SystemExit('the tasks.py of the reader was imported')\n")
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf" / "__init__.py").write_text("raise SystemExit('the conf of the reader was imported')\n")

    def xqmap(command: str, *arguments: str) -> str:
        return done(environment, "-m", f"xqmap.{command}", *arguments, cwd=tmp_path, OMP_NUM_THREADS="1")

    assert "sorting keeps the contract" in xqmap("check", "task=sorting", "evaluation.seeds=[0]")
    small = ["trainer=smoke", "qnet.width=4", "qnet.depth=1", "logger.mode=disabled", "evaluation.seeds=[0]"]
    xqmap("train", "+task=sorting", *small, "hydra.run.dir=run", "collector=parallel", "collector.workers=1")
    assert json.loads((tmp_path / "run" / "evaluation.json").read_text())["task"] == "sorting"
    assert "parcel" in xqmap("explain", "run=run")
    decision = json.loads((tmp_path / "run" / "figures" / "scene0" / "decision.json").read_text())
    assert decision["components"] == ["urgency", "size", "height"]
    assert "sorting" in xqmap("report", "runs=.", "format=md", "out=report.md") + (tmp_path / "report.md").read_text()
    assert "keeps the contract" not in xqmap("doctor", "only=threads")
