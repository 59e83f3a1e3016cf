"""What strangers hand over: damaged, foreign and malicious files and settings are refused, and nothing in them runs."""

from __future__ import annotations

import ast
import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from xqmap.benchmarks.robustness import fuzz, hostile, samples
from xqmap.config import build, plugins
from xqmap.errors import UserError
from xqmap.evaluation import results
from xqmap.evaluation.run import evaluate_run
from xqmap.explanations import Decision
from xqmap.explanations.views import plots
from xqmap.runs import checkpoint
from xqmap.runs.run import load_run

ROOT = plugins.CONF.parent


@pytest.fixture
def policy(toy_config: Callable[..., DictConfig], tmp_path: Path) -> Path:
    """A run directory with an untrained policy of the toy world."""
    cfg = toy_config("qnet.width=2")
    facts = {
        "config": OmegaConf.to_container(cfg, resolve=True),
        "pixel_size": 0.1,
        "noise": {"left": 0.1},
        "frames": 0,
    }
    checkpoint.write(tmp_path / "run" / checkpoint.POLICY, build.qmaps(cfg, 0.1).state_dict(), facts)
    return tmp_path / "run"


def changed(policy: Path, **settings: object) -> Path:
    tensors, facts = checkpoint.read(policy / checkpoint.POLICY)
    for name, value in settings.items():
        part = facts
        *path, last = name.split("__")
        for key in path:
            part = part[key]
        part[last] = value
    checkpoint.write(policy / checkpoint.POLICY, tensors, facts)
    return policy


def test_nothing_that_settings_name_is_run_but_classes_of_our_own(tmp_path: Path) -> None:
    tried, refused = hostile.refused_settings(tmp_path)
    assert tried == refused > 100
    assert not (tmp_path / "was_run").exists()


def test_every_damaged_file_is_refused(policy: Path) -> None:
    tried, refused = hostile.refused_files(policy / checkpoint.POLICY, 50)
    assert tried == refused > 300
    load_run(policy)


def test_what_is_no_file_is_refused_at_once_by_every_reader(tmp_path: Path) -> None:
    tried, refused = hostile.refused_places(tmp_path / "places")
    assert tried == refused > 20


def test_more_than_anybody_has_is_refused_before_it_is_worked_on(policy: Path) -> None:
    tried, refused = hostile.refused_crowds(policy / checkpoint.POLICY)
    assert tried == refused == 9
    load_run(policy)


def test_a_run_of_before_plays_on(policy: Path) -> None:
    assert "windowed" not in load_run(changed(policy, config__loss__windowed=True)).cfg.loss
    with pytest.raises(UserError, match="windowd"):
        load_run(changed(policy, config__loss__windowd=True))


def test_a_strangers_run_directory_is_safe_to_open(policy: Path, tmp_path: Path) -> None:
    marker = tmp_path / "was_run"
    for environment in hostile.settings(marker):
        run = load_run(changed(policy, config__task__env=environment))
        with pytest.raises(UserError, match=r"task\.env"):
            evaluate_run(run, run.cfg.evaluation, tmp_path / "evaluation.json")
    assert not marker.exists()
    assert not (tmp_path / "evaluation.json").exists()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"config__task__name": "${oc.env:HOME}"}, "settings"),
        ({"config__qnet__width": 4096}, "does not fit"),
        ({"config__qnet__width": "wide"}, "qnet.width"),
        ({"config__loss__gamma": 7}, "loss.gamma"),
        ({"config__task": {}}, "task.name has no value"),
        ({"config__evaluation__seeds": [0, [1]]}, "evaluation.seeds"),
        ({"config": "task: {name: x}"}, "settings"),
        ({"pixel_size": float("nan")}, "pixel size"),
        ({"noise": {"left": "much"}}, "does not fit"),
    ],
)
def test_settings_in_a_file_are_checked_as_those_of_a_person(
    policy: Path, settings: dict[str, object], named: str
) -> None:
    with pytest.raises(UserError, match=named):
        load_run(changed(policy, **settings))


def test_a_newer_file_asks_for_a_newer_program(policy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = policy / checkpoint.POLICY
    content = checkpoint.read(path)
    for change, fix in ((1, "update xqmap"), (-1, "train again")):
        with monkeypatch.context() as patch:
            patch.setattr(checkpoint, "_FORMAT", checkpoint._FORMAT + change)
            checkpoint.write(path, *content)
        with pytest.raises(UserError, match=fix):
            checkpoint.read(path)


def test_a_damaged_checkpoint_is_refused_and_the_one_before_it_named(tmp_path: Path) -> None:
    for frames in (4, 8):
        facts = dict.fromkeys(checkpoint._TO_GO_ON, frames)
        checkpoint.write(tmp_path / checkpoint.TRAINING.format(frames), {"a": torch.zeros(3)}, facts)
    newest, before = checkpoint.trainings(tmp_path)
    newest.write_bytes(newest.read_bytes()[:-1])
    with pytest.raises(UserError, match=f"{newest.name}.*resume=.*{before.name}"):
        checkpoint.read_training(tmp_path)
    assert checkpoint.read_training(before)[1]["frames"] == 4
    assert newest.exists()


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("runs", 0, "choices"), 10**400),
        (("runs", 0, "regret"), 10**400),
        (("runs", 0, "components", "color"), float("inf")),
        (("baselines", "random pixel", "regret"), None),
        (("baselines", "random pixel", "ci95", 0), 1e300),
        (("confusion", "blue flat block", "ground"), -(10**400)),
        (("baselines", "random pixel", "regret"), "1"),
        (("task",), "\x1b[2J"),
        (("method",), "\ud800"),
    ],
)
def test_a_strangers_evaluation_is_left_out_of_a_report(
    place: tuple[str | int, ...], value: object, tmp_path: Path
) -> None:
    content = copy.deepcopy(samples.EVALUATION)
    part: Any = content
    for name in place[:-1]:
        part = part[name]
    part[place[-1]] = value
    (tmp_path / "evaluation.json").write_text(json.dumps(content))
    found, left_out = results.collect(tmp_path)
    assert not found
    assert len(left_out) == 1


def test_settings_nested_too_deep_are_none(tmp_path: Path) -> None:
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text("[" * 5000)
    assert results.settings_of(tmp_path) == {}


def test_a_name_with_dollar_signs_is_no_formula(tmp_path: Path) -> None:
    content = json.loads(
        json.dumps(samples.DECISION).replace("flatness", "$\\\\foo$").replace("red block", "a $\\\\frac$")
    )
    (tmp_path / "decision.json").write_text(json.dumps(content))
    decision = Decision.load(tmp_path / "decision.json")
    assert decision.components[0] == "$\\foo$"
    plots.save(plots.bars(decision), tmp_path / "bars")


def test_loading_can_run_no_code() -> None:
    """No pickle, no eval, no torch.load, no unsafe yaml anywhere in what is shipped."""
    forbidden = {"pickle", "cloudpickle", "dill", "marshal", "shelve", "joblib"}
    calls = {"eval", "exec", "torch.load", "yaml.load", "yaml.unsafe_load", "np.load", "numpy.load"}
    for path in (*ROOT.glob("xqmap/**/*.py"), *ROOT.glob("tasks/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import | ast.ImportFrom):
                imported = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
                assert not forbidden & {name.split(".")[0] for name in imported}, path
            plain = isinstance(node, ast.Call) and any(
                ast.unparse(word) == "allow_pickle=False" for word in node.keywords
            )
            if isinstance(node, ast.Call) and not plain:
                assert ast.unparse(node.func) not in calls, f"{path}:{node.lineno}"


def test_any_decision_file_is_explained_or_refused_in_one_line(tmp_path: Path) -> None:
    count = fuzz.decisions(tmp_path, 300)
    assert 0 < count["refused"] < count["cases"]
    assert count["crashes"] == 0


def test_any_run_directory_is_taken_or_refused_in_one_line(policy: Path, tmp_path: Path) -> None:
    count = fuzz.run_directories(policy / checkpoint.POLICY, tmp_path / "other", 100)
    assert 0 < count["refused"] < count["cases"]
    assert count["crashes"] == 0


def test_a_report_on_anything_is_written_or_refused_in_one_line(tmp_path: Path) -> None:
    count = fuzz.reports(tmp_path, 100)
    assert 0 < count["refused"] < count["cases"]
    assert count["crashes"] == 0


def test_any_overrides_are_taken_or_refused_in_one_line() -> None:
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        count = fuzz.overrides(60)
    assert 0 < count["refused"] <= count["cases"]
    assert count["crashes"] == 0


def test_a_crash_is_counted_and_told(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fuzz, "_refused", lambda act: 1 / 0)
    assert fuzz.decisions(tmp_path, 3)["crashes"] == 3
    assert "ZeroDivisionError" in capsys.readouterr().out
