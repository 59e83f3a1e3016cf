"""The commands of the README on the real landing world, small: train, evaluate, explain, chat, go on."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig
from torchrl.envs.utils import check_env_specs, step_mdp

from tests.browser import everything_is_drawn, opened, table
from tests.commands import call, start
from xqmap import keys
from xqmap.config import build, plugins, schema

pytestmark = pytest.mark.sim


def settings(*overrides: str) -> DictConfig:
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        return compose("config", ["+task=landing", *overrides])


def test_the_environment_keeps_its_specs() -> None:
    env = build.make_env(settings(), 3)()
    try:
        check_env_specs(env)
    finally:
        env.close()


def test_several_landings_make_one_episode_and_weights_scale_the_reward() -> None:
    env = build.make_env(settings("task.env.landings_per_episode=3", "task.weights.flatness=2"), 5)()
    try:
        state, done, made = env.reset(), False, 0
        while not done:
            state[keys.ACTION] = torch.tensor(env.action_at(env.task.oracle_point()))
            result = env.step(state)["next"]
            expected = 2 * result[keys.REWARD_COMPONENTS][0] + result[keys.REWARD_COMPONENTS][1]
            assert float(result[keys.REWARD]) == pytest.approx(float(expected))
            assert float(result[keys.REWARD]) == pytest.approx(float(result[keys.REWARD_AVAILABLE]))
            state, done, made = step_mdp(state), bool(result[keys.DONE]), made + 1
        assert made == 3
    finally:
        env.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("landing")
    done = start("train", "+task=landing", "trainer=smoke", "evaluation.seeds=[0,1]", "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "run/evaluation.json" in done.stdout
    return folder / "run"


def test_a_run_leaves_what_it_should(run: Path) -> None:
    assert {".hydra", "checkpoint", "evaluation.json", "metrics.csv", "wandb", "figures"} <= {
        path.name for path in run.iterdir()
    }
    assert list((run / "wandb").glob("offline-run-*/*.wandb"))
    assert list((run / "figures").glob("qmaps*.png"))
    result = json.loads((run / "evaluation.json").read_text())
    assert (result["task"], result["method"], result["success"]["choices"]) == ("landing", "xqmap", 2)
    assert result["baselines"]["oracle"]["mean"] == 1.0
    assert set(result["runs"][0]["components"]) == {"flatness", "color"}
    with open(run / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["frames"]) == 40
    shares = [float(rows[-1][f"share/{name}"]) for name in ("simulate", "render", "fuse", "infer", "update")]
    assert sum(shares) == pytest.approx(1.0)


def test_evaluate_repeats_the_table(run: Path) -> None:
    done = call(
        "evaluate", "run=run", "evaluation.seeds=[0,1]", "evaluation.baselines=false", "out=again.json", cwd=run.parent
    )
    assert done.returncode == 0, done.stderr
    first, again = (json.loads(path.read_text()) for path in (run / "evaluation.json", run.parent / "again.json"))
    assert first["runs"] == again["runs"]
    assert first["weights_sha256"] == again["weights_sha256"]
    assert again["baselines"] == {}


def test_a_sheet_plays_other_scenes_into_a_file_of_its_own(run: Path) -> None:
    before = (run / "evaluation.json").read_bytes()
    small = ["evaluation.seeds=[0,1]", "evaluation.baselines=false", "evaluation.calibration=true"]
    done = call("evaluate", "run=run", "sheets=slopes", *small, cwd=run.parent)
    assert done.returncode == 0, done.stderr
    sheet = json.loads((run / "evaluation-slopes.json").read_text())
    assert (sheet["sheet"], sheet["settings"]["env"]["incline_deg"]) == ("slopes", [2.0, 8.0])
    assert set(sheet["calibration"]["exact"]) == {"flatness", "color"}
    assert "flatness, exact value" in done.stdout
    assert (run / "evaluation.json").read_bytes() == before
    for wrong, named in [
        (["sheets=steep"], "conf/sheet/landing"),
        (["+task.env.wind=3", "out=x.json"], "no setting 'wind'"),
        (["+task.env._target_=os.system", "out=x.json"], "no setting '_target_'"),
        (["+task.env.light=0"], "task.env.light is changed: give out=FILE"),
        (["+task.weights.color=5"], "task.weights.color is changed: give out=FILE"),
        (["evaluation.choices=7"], "not 7: give out=FILE"),
        (["sheets=slopes", "evaluation.seeds=[3]"], "not [3]: give out=FILE"),
        (["evaluation.seeds=[3,4,3]", "out=x.json"], "names 3 twice"),
    ]:
        refused = call("evaluate", "run=run", *wrong, cwd=run.parent)
        assert refused.returncode != 0
        assert named in refused.stderr
    assert not (run.parent / "x.json").exists()


def test_exact_values_of_landing_are_what_landing_pays() -> None:
    env = build.make_env(settings(), 5)()
    try:
        env.reset()
        things, exact = env.task.scene_objects(), env.task.exact_values(0.9)
        assert exact.shape == (len(things), 2)
        for thing, (flat, color) in zip(things, exact, strict=True):
            assert flat == (thing.attributes["kind"] == "flat block")
            assert color == (thing.attributes["color"] != "gray")
    finally:
        env.close()


@pytest.fixture(scope="module")
def told(run: Path) -> Path:
    """A decision of the run, explained and asked about, where these commands leave it."""
    done = call("explain", "run=run", "scene_seed=3", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    done = call("chat", "run=run", "scene_seed=3", 'question="Why?"', cwd=run.parent)
    assert done.returncode == 0, done.stderr
    assert "I chose to land on" in done.stdout
    return run / "figures" / "scene3"


def test_explain_writes_every_view(told: Path) -> None:
    names = {
        "decision.json",
        "qmaps.png",
        "values.png",
        "rdx.png",
        "overview.png",
        "explanation.txt",
        "explanation.html",
        "dialogue.json",
    }
    assert names <= {path.name for path in told.iterdir()}
    decision = json.loads((told / "decision.json").read_text())
    assert [c["label"] for c in decision["candidates"]] == ["Selected", "A", "B"]
    for candidate in decision["candidates"]:
        assert candidate["overall"] == pytest.approx(sum(candidate["values"].values()))
    html = (told / "explanation.html").read_text()
    assert "http://" not in html.replace("http://www.w3.org", "")
    assert "https://" not in html


def test_the_report_of_a_run_shows_what_it_did_and_what_it_said(run: Path, told: Path) -> None:
    done = call("report", "runs=run", "out=report.html", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    with opened(run.parent / "report.html") as page:
        rows = {row["method"]: row for row in table(page)}
        mean = json.loads((run / "evaluation.json").read_text())["success"]["mean"]
        assert (rows["xqmap"]["best choices"], rows["xqmap"]["paper"]) == (f"{100 * mean:.1f} %", "90 ± 0.09 %")
        assert rows["oracle"]["best choices"] == "100.0 %"
        # Intervals, five groups of curves, shares of time, the decision's bars; Q-Maps over training and of the
        # decision.
        everything_is_drawn(page, charts=8, pictures=1 + len(list((run / "figures").glob("qmaps*.png"))))
        for sentence in (told / "explanation.txt").read_text().splitlines():
            assert page.get_by_text(sentence).count() >= 1
        assert page.get_by_text("Why?", exact=True).count() == 1
        assert page.get_by_text("python -m xqmap.train +task=landing trainer=smoke").count() == 1
        page.set_viewport_size({"width": 420, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") == 420


def test_a_finished_run_is_not_overwritten(run: Path) -> None:
    again = call("train", "+task=landing", "hydra.run.dir=run", cwd=run.parent)
    assert again.returncode != 0
    assert "already holds a run" in again.stderr
    assert (run / "evaluation.json").exists()
