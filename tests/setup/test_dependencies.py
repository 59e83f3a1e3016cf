"""What pyproject.toml asks for is what is imported, and constraints.txt has a version of all of it."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCK = (ROOT / "constraints.txt").read_text()


def names(requirements: list[str]) -> set[str]:
    return {re.sub(r"[-_.]+", "-", re.split(r"[\s;<>=!\[]", line)[0]).lower() for line in requirements} - {"xqmap"}


BASE = names(PROJECT["dependencies"])
EXTRAS = {name: names(lines) for name, lines in PROJECT["optional-dependencies"].items()}


def imported(folder: str) -> set[str]:
    """The distributions that a folder's modules import."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module))
    top = {name.split(".")[0] for name in found} - sys.stdlib_module_names - {"conf", "tasks", "tests", "xqmap"}
    return names([packages_distributions().get(name, [name])[0] for name in top])


def test_the_framework_imports_what_it_declares_and_no_simulator() -> None:
    assert imported("xqmap") <= BASE | EXTRAS["llm"] | EXTRAS["ray"] | EXTRAS["onnx"] | EXTRAS["dev"]


def test_the_worlds_import_what_the_extra_sim_declares() -> None:
    assert imported("tasks") <= BASE | EXTRAS["sim"]


def test_every_dependency_is_locked_but_the_planner_that_not_every_python_has() -> None:
    locked = names([line for line in LOCK.splitlines() if not line.startswith("#")])
    assert BASE.union(*EXTRAS.values()) <= locked
    assert "mplib" not in locked


@pytest.mark.parametrize("file", ["constraints.txt", "pyproject.toml"])
def test_no_registry_is_named(file: str) -> None:
    assert not re.search(r"index-url|find-links|https?://\S*(simple|whl)", (ROOT / file).read_text())
