"""A newcomer's route: the files that the pages have readers write are the worked example, and keep the contract."""

from __future__ import annotations

import importlib.util
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import yaml

from tests.documents import PAGES, ROOT
from xqmap.envs.check import check_task
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.explanations.perception import Simulator, Vision
from xqmap.explanations.views.sentences import wording_for

WORLD, COMPONENT = PAGES["add_a_world"], PAGES["add_a_component"]
EXAMPLE = ROOT / "examples" / "sorting_world"
SETTINGS, CODE = "sorting_world/conf/task/sorting.yaml", "sorting_world/__init__.py"


@pytest.fixture
def imported(tmp_path: Path) -> Callable[[str, str], ModuleType]:
    """A module of that name with that text."""

    def load(name: str, text: str) -> ModuleType:
        path = tmp_path / f"{name}.py"
        path.write_text(text)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        # Where dataclasses look for it.
        sys.modules[name] = module
        spec.loader.exec_module(module)
        return module

    return load


def broken(world: Callable[..., Any], settings: dict[str, Any]) -> list[str]:
    """The rules that a world of the page breaks."""
    task = settings["task"]
    arguments = {name: value for name, value in task["env"].items() if name != "_target_"}
    findings = check_task(lambda weights: world(weights=weights, **arguments), task["components"], scenes=[0])
    return [str(finding) for finding in findings if finding.troubles]


@pytest.mark.parametrize("name", ["pyproject.toml", SETTINGS, CODE])
def test_the_pages_world_is_the_worked_example(name: str) -> None:
    assert WORLD.files[name] == (EXAMPLE / name).read_text()


def test_the_worked_example_has_no_file_that_the_page_has_not() -> None:
    files = {str(path.relative_to(EXAMPLE)) for path in EXAMPLE.rglob("*") if path.suffix in (".py", ".toml", ".yaml")}
    assert files == {"pyproject.toml", SETTINGS, CODE}


def test_one_more_component(imported: Callable[[str, str], ModuleType]) -> None:
    names, pays = (block.text for block in COMPONENT.blocks if block.language == "python" and not block.title)
    code = _replaced(WORLD.files[CODE], "REWARD_COMPONENTS = (", names)
    (told,) = [block.text for block in COMPONENT.blocks if block.language == "yaml" and not block.title]
    settings = yaml.safe_load(WORLD.files[SETTINGS])
    settings["task"] |= yaml.safe_load(told)
    assert settings["task"]["components"] == list(settings["task"]["weights"])
    # Where only the names are changed, the check says so.
    assert broken(imported("half_done", code).SortingWorld, settings)
    whole = _replaced(code, "return np.array([URGENCY", pays)
    assert broken(imported("done", whole).SortingWorld, settings) == []


def _replaced(code: str, begins: str, line: str) -> str:
    (old,) = [there for there in code.splitlines() if there.strip().startswith(begins)]
    return code.replace(old, old[: len(old) - len(old.lstrip())] + line.strip())


def test_senses(imported: Callable[[str, str], ModuleType]) -> None:
    module = imported("sorting_world_of_the_page", WORLD.files[CODE])
    arguments = yaml.safe_load(WORLD.files[SETTINGS])["task"]["env"]
    del arguments["_target_"]
    env = ManiSkillEnv(lambda: module.SortingWorld(weights={}, **arguments))
    vision = yaml.safe_load(COMPONENT.files["sorting_world/conf/explain/perception/parcels.yaml"])
    assert vision.pop("_target_") == "xqmap.explanations.perception.Vision"
    eyes = imported("eyes", COMPONENT.files["sorting_world/eyes.py"]).Eyes()
    for _ in range(5):
        heightmap = env.reset()["heightmap"].numpy()
        known = Simulator()(heightmap, env.grid, env.task)
        seen = Vision(**vision)(heightmap, env.grid, None)
        assert sorted(seen.names) == sorted(known.names)
        for parcel in env.task.scene_objects():
            row, column = divmod(env.action_at(parcel.middle), known.cells.shape[1])
            assert seen.name((row, column)) == known.name((row, column)) == parcel.name
        named = eyes(heightmap, env.grid, None)
        assert sorted(set(named.names)) == ["parcel", "tallest parcel"]
        row, column = np.unravel_index(int(heightmap[3].argmax()), heightmap.shape[1:])
        assert named.name((int(row), int(column))) == "tallest parcel"


def test_words_sheet_and_entry_points() -> None:
    task = yaml.safe_load(WORLD.files[SETTINGS])["task"]
    words = yaml.safe_load(WORLD.files["sorting_world/conf/explain/wording/sorting.yaml"])
    assert set(words) <= set(wording_for("plain"))
    assert set(words["meanings"]) == set(words["synonyms"]) == set(task["components"])
    sheet = yaml.safe_load(WORLD.files["sorting_world/conf/sheet/sorting/many.yaml"])
    assert set(sheet["task"]["env"]) <= set(task["env"])
    offered = [tomllib.loads(block.text) for block in COMPONENT.blocks if block.language == "toml"]
    named = [entry["project"]["entry-points"]["xqmap.perception"] for entry in offered]
    assert named == [{"parcels": "sorting_world"}, {"eyes": "sorting_world.eyes:Eyes"}]
