"""The worlds as a package: under whichever name it is installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tasks

TASKS = Path(tasks.__file__).parent


@pytest.mark.sim
def test_the_package_works_under_another_name(tmp_path: Path) -> None:
    shutil.copytree(TASKS, tmp_path / "xqmap_tasks", ignore=shutil.ignore_patterns("__pycache__"))
    program = """
import importlib, pkgutil, sys
import xqmap_tasks
for found in pkgutil.walk_packages(xqmap_tasks.__path__, "xqmap_tasks."):
    importlib.import_module(found.name)
from pathlib import Path
from xqmap_tasks.agents.aircraft import Aircraft
from xqmap_tasks.agents.ur5e import UR5e
for path in (Path(agent.urdf_path) for agent in (Aircraft, UR5e)):
    assert path.is_file() and "xqmap_tasks" in path.parts
assert not any(name.split(".")[0] == "tasks" for name in sys.modules)
"""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    # Not isolated (-I): the copy lies in the working directory, and nothing else may be found there.
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_no_file_names_the_package_it_lies_in() -> None:
    naming = [path.name for path in TASKS.rglob("*.py") if "tasks." in path.read_text(encoding="utf-8")]
    assert not naming
