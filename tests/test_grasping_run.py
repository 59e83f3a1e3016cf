"""The commands of the README on the real grasping world, small: train, explain an episode, film."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from torchrl.envs.utils import check_env_specs

from tests.browser import everything_is_drawn, opened, table
from tests.commands import call
from xqmap.config import build, plugins, schema
from xqmap.reports import curves

pytestmark = pytest.mark.sim


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("grasping")
    small = ["trainer=smoke", "trainer.frames=20", "evaluation.seeds=[0]", "evaluation.choices=3"]
    # An agent that has learned nothing fails at once, and would see one decision.
    on = ["task.env.failure=stays", "loss.gamma=0"]
    done = call("train", "+task=grasping", *small, *on, "hydra.run.dir=run", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


def test_the_environment_keeps_its_specs() -> None:
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        env = build.make_env(compose("config", ["+task=grasping"]), 3)()
    try:
        check_env_specs(env)
        assert env.grid.shape == (320, 160)
    finally:
        env.close()


def test_the_table_counts_choices_and_the_oracle_makes_the_best(run: Path) -> None:
    result = json.loads((run / "evaluation.json").read_text())
    assert (result["task"], result["success"]["choices"]) == ("grasping", 3)
    assert result["baselines"]["oracle"]["mean"] == 1.0
    assert set(result["runs"][0]["components"]) == {"shape", "color"}


def test_an_episode_is_explained_decision_by_decision(run: Path) -> None:
    done = call("explain", "run=run", "scene_seed=3", "steps=2", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    folder = run / "figures" / "scene3"
    decisions = [json.loads((folder / f"step0{i}" / "decision.json").read_text()) for i in (1, 2)]
    assert all(decision["components"] == ["shape", "color"] for decision in decisions)
    assert (folder / "explanation.html").exists()
    done = call("report", "runs=run", "out=report.html", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    with opened(run.parent / "report.html") as page:
        assert {row["method"]: row["best choices"] for row in table(page)}["oracle"] == "100.0 %"
        with open(run / "metrics.csv", newline="") as file:
            filled = {name.partition("/")[0] for row in csv.DictReader(file) for name, value in row.items() if value}
        # Intervals, shares of time and the decision's bars, and the curves of what so short a training had to log.
        everything_is_drawn(page, charts=3 + len(filled & set(curves.METRICS)), pictures=2)
        assert page.get_by_role("heading", name="Chosen and best: xqmap").count() == 1


def test_a_film_shows_the_robot_at_work(run: Path) -> None:
    done = call("film", "run=run", "scene_seed=3", "out=pick.mp4", cwd=run.parent)
    assert done.returncode == 0, done.stderr
    assert "wrote pick.mp4: 1 decisions" in done.stdout
    content = (run.parent / "pick.mp4").read_bytes()
    assert content[4:8] == b"ftyp" and len(content) > 10_000
    refused = call("film", "run=run", "out=pick.gif", cwd=run.parent)
    assert refused.returncode != 0 and ".mp4" in refused.stderr
    assert not list(run.parent.glob("*.part*"))
