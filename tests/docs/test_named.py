"""What the pages name exists: commands and their settings, files, Python names, keys, columns."""

from __future__ import annotations

import ast
import importlib
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from tests.documents import EVERY, PAGES, ROOT, Page
from tests.explanations.test_decision import made
from xqmap.config import arguments, plugins, schema
from xqmap.evaluation import tables
from xqmap.evaluation.tables import COLUMNS
from xqmap.trainers.trainer import Trainer

CONFIG = {"train": "config", "check": "check"}
# What the pages have their readers write; tests/docs/test_newcomer.py follows them.
THEIRS = re.compile(r"task=sorting|perception=(parcels|eyes|NAME)|task=NAME|task\.env\.parcels|task\.weights\.size")
TRAINING = [page for page in EVERY if page.commands]


@cache
def composed(command: str, *given: str) -> DictConfig:
    """A command's settings; of a sweep those of its first job."""
    schema.register()
    changes = []
    parser = OverridesParser.create()
    for override in parser.parse_overrides(arguments.literal(given)):
        first = next(iter(override.sweep_string_iterator())) if override.is_sweep_override() else None
        changes.append(override.input_line or "" if first is None else f"{override.get_key_element()}={first}")
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        return compose(CONFIG.get(command, command), changes, return_hydra_config=True)


@pytest.mark.parametrize("page", TRAINING, ids=lambda page: page.name)
def test_commands_compose(page: Page) -> None:
    for command, *given in page.commands:
        assert (ROOT / "xqmap" / f"{command}.py").is_file(), command
        given = [word for word in given if word != "-m"]
        # Without settings it is only mentioned.
        if given and not THEIRS.search(" ".join(given)):
            cfg = composed(command, *given)
            if command == "train" and any("task=" in word for word in given):
                schema.validate(cfg)


def _settings() -> Iterator[DictConfig]:
    for task in ("landing", "grasping"):
        yield composed("train", f"+task={task}", "sheets=[]")
    yield composed("chat", "llm=openai")
    for command in ("evaluate", "explain", "export", "film", "report", "bench", "doctor"):
        yield composed(command)
    yield composed("train", "+task=landing", "hydra/launcher=slurm")


@pytest.fixture(scope="module")
def known() -> list[DictConfig]:
    return list(_settings())


def _is_setting(name: str, known: list[DictConfig]) -> bool:
    for cfg in known:
        parent, _, last = name.rpartition(".")
        within = OmegaConf.select(cfg, parent, throw_on_missing=False) if parent else cfg
        if isinstance(within, DictConfig) and last in within:
            return True
    return False


def _is_python(name: str) -> bool:
    """``package.module.Class.member``, as far as it can be imported."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:end]))
        except ImportError:
            continue
        for part in parts[end:]:
            if not hasattr(found, part):
                return part in getattr(found, "__annotations__", {})
            found = getattr(found, part)
        return True
    return False


# Groups of entry points, what a wheel calls conf/, and how a version is written.
ELSEWHERE = {plugins.TASKS, plugins.PERCEPTION, "xqmap.conf", "vX.Y.Z"}
DOTTED = re.compile(r"([a-zA-Z_]\w*(?:\.[a-zA-Z_]\w*)+)(=.*)?")
FILES = (
    ".py",
    ".md",
    ".yaml",
    ".json",
    ".csv",
    ".png",
    ".npz",
    ".txt",
    ".html",
    ".toml",
    ".safetensors",
    ".cff",
    ".mp4",
    ".pt2",
    ".onnx",
)


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.name)
def test_settings_and_python_names_exist(page: Page, known: list[DictConfig]) -> None:
    removed = {"loss.windowed"}  # the changelog tells of it
    for code in page.code:
        found = DOTTED.fullmatch(code)
        if not found or found[1].endswith(FILES) or THEIRS.search(code):
            continue
        name = found[1]
        if page.name == "CHANGELOG.md" and name in removed:
            assert not _is_setting(name, known)
            continue
        assert name in ELSEWHERE or _is_setting(name, known) or _is_python(name), code


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.name)
def test_settings_without_a_dot_exist(page: Page, known: list[DictConfig]) -> None:
    for code in page.code:
        found = re.fullmatch(r"\+?([a-z_]+)=(\S*)", code)
        if found and not THEIRS.search(code) and found[1] not in ("key", "shared_argmax"):
            assert (ROOT / "conf" / found[1]).is_dir() or _is_setting(found[1], known), code
            choices = {path.stem for path in (ROOT / "conf" / found[1]).glob("*.yaml")}
            assert not choices or found[2] in choices | {"NAME", "TASK"}, code


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.name)
def test_files_of_the_repository_exist(page: Page) -> None:
    for code in page.code:
        if re.fullmatch(r"(conf|xqmap|tasks|tests|docs|examples|\.ci)/[\w./*<>+-]*", code):
            pattern = re.sub(r"<\w+>|NAME", "*", code.rstrip("/"))
            # What a report writes is no file of ours.
            assert list(ROOT.glob(pattern)) or (code == "docs/landing.png"), code


# -- tables that are complete ------------------------------------------------------------------------------------------


def _metrics(task: str) -> list[str]:
    tree = ast.parse((ROOT / "tasks" / f"{task}.py").read_text())
    (found,) = [
        ast.literal_eval(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "METRICS"
    ]
    return list(found)


@pytest.mark.parametrize("method", ["xqmap", "qlearning"])
def test_every_column_of_the_log_is_told(method: str, toy_config: Callable[..., DictConfig], tmp_path: Path) -> None:
    trainer = Trainer(toy_config(f"method={method}"), tmp_path)
    trainer.close()
    trainer.log.close()
    head = (tmp_path / "metrics.csv").read_text().splitlines()[0].split(",")
    told = [row[0] for row in PAGES["metrics"].table("column") if row[0] in head or "/<" in row[0]]
    patterns = {name: re.compile(re.sub(r"<\w+>", r"\\w+", name)) for name in told}
    assert [column for column in head if not any(p.fullmatch(column) for p in patterns.values())] == []
    assert [name for name, p in patterns.items() if not any(p.fullmatch(column) for column in head)] == []


def test_the_worlds_own_metrics_are_told() -> None:
    told = [(task, column) for task, column, *_ in PAGES["metrics"].table("task")]
    assert told == [(task, f"metric/{name}") for task in ("landing", "grasping") for name in _metrics(task)]


def test_every_key_of_an_evaluation_is_told() -> None:
    files = [*(ROOT / "docs" / "paper").rglob("evaluation*.json"), *ROOT.glob("xqmap/pretrained/*/evaluation.json")]
    contents = [yaml.load(path.read_text(), yaml.CSafeLoader) for path in files]
    told = {name for row in PAGES["metrics"].table("key") for name in row[0].split(", ")}
    used = {key for content in contents for key in content}
    used |= {
        key
        for content in contents
        for part in (content.get("calibration") or {}).get("exact", {}).values()
        for key in part
    }
    assert used <= told
    assert told <= used | {"baselines_from", "sheet"}
    runs = {key for content in contents for run in content["runs"] for key in run}
    rates = {key for content in contents for key in content["success"]}
    machine = {key for content in contents for key in content["machine"]} - {"simulation", "rendering"}
    assert runs | rates | machine <= set(PAGES["metrics"].code)


def test_every_column_of_the_table_is_told() -> None:
    told = [name for row in PAGES["metrics"].table("column") for name in row[0].split(", ")]
    assert set(COLUMNS) <= set(told)
    for name in tables.comma_separated([]).strip().split(","):
        assert name in PAGES["metrics"].code


def test_every_key_of_a_decision_is_told() -> None:
    told = {name for row in PAGES["explain"].table("key") for name in row[0].split(", ")}
    # With maps there is a scene, too.
    assert told == set(made(Selected=(0.93, 1.0), A=(1.0, 0.0), B=(0.02, 1.02)).to_dict()) | {"scene"}


def test_extras_sweeps_sheets_and_folders_are_all_there() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {row[0] for row in PAGES["quickstart"].table("extra")} == set(extras)
    sweeps = {name for row in PAGES["sweeps"].table("sweep") for name in row[0].split(", ")}
    assert sweeps == {path.stem for path in (ROOT / "conf" / "sweep").glob("*.yaml")}
    sheets = {(row[0], row[1]) for row in PAGES["sweeps"].table("task")}
    assert sheets == {(path.parent.name, path.stem) for path in (ROOT / "conf" / "sheet").rglob("*.yaml")}
    folders = {row[0].rstrip("/") for row in PAGES["layout"].table("folder")}
    packages = {f"xqmap/{path.parent.name}" for path in (ROOT / "xqmap").glob("*/__init__.py")}
    assert packages <= folders
    assert all(list(ROOT.glob(folder)) for folder in folders)
