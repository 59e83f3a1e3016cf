"""Sweeps in the toy world: no two jobs share anything, nothing is done twice, and a table comes out."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf

from xqmap import doctor, train
from xqmap.config import build, plugins, schema
from xqmap.errors import UserError
from xqmap.evaluation import sheets

TOY = ["+task=toy"]


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Runs ``python -m xqmap.train -m`` in this process; returns the sweep's directory."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Path:
        monkeypatch.setattr(sys, "argv", ["train", "-m", *TOY, "hydra.sweep.dir=all", *arguments])
        train.main()
        return tmp_path / "all"

    return run


def jobs(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob("*/evaluation.json"))


@pytest.mark.sim
def test_jobs_share_no_directory_no_wandb_id_and_no_scene(
    sweep: Callable[..., Path], capfd: pytest.CaptureFixture[str]
) -> None:
    folder = sweep("seed=range(0,2)", "method=xqmap,qlearning")
    found = jobs(folder)
    assert len(found) == 4
    ids = [path.name.rsplit("-", 1)[1] for job in found for path in (job / "wandb").glob("offline-run-*")]
    assert len(set(ids)) == len(ids) == 4
    settings = [OmegaConf.load(job / ".hydra" / "config.yaml") for job in found]
    assert len({(cfg.method.name, cfg.seed) for cfg in settings}) == 4
    # A name that run=DIR takes as it is.
    assert found[0].name == "+task-toy+method-qlearning+seed-0"
    assert len({json.loads((job / "evaluation.json").read_text())["weights_sha256"] for job in found}) == 4
    # The baselines were played once.
    played = [json.loads((job / "evaluation.json").read_text()) for job in found]
    assert sorted("baselines_from" in content for content in played) == [False, True, True, True]
    first = next(job for job, content in zip(found, played, strict=True) if "baselines_from" not in content)
    assert {content.get("baselines_from", f"{first.name}/evaluation.json") for content in played} == {
        f"{first.name}/evaluation.json"
    }
    assert all(content["baselines"] == played[0]["baselines"] != {} for content in played)
    assert "bootstrap" in (folder / "table.csv").read_text()
    with open(folder / "table.csv", newline="") as file:
        rows = {row["method"]: row for row in csv.DictReader(file)}
    assert (rows["xqmap"]["training_seeds"], rows["oracle"]["mean"]) == ("0 1", "1.0")
    assert "random pixel" in (folder / "table.md").read_text()
    assert "wrote table.txt, table.md, table.csv to all" in capfd.readouterr().out


@pytest.mark.sim
def test_what_is_done_is_not_done_again_and_what_was_interrupted_goes_on(
    sweep: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from xqmap.trainers.trainer import Trainer

    step, steps = Trainer._step, [0]

    def stepping(self: Trainer, batch):  # type: ignore[no-untyped-def]
        steps[0] += 1
        # The second job is asked to stop in the middle.
        if steps[0] == 6 + 3:
            self.stopped_by = 2
        return step(self, batch)

    monkeypatch.setattr(Trainer, "_step", stepping)
    with pytest.raises(SystemExit) as stopped:
        sweep("seed=0,1,2")
    assert stopped.value.code == 130
    folder = Path("all")
    assert len(jobs(folder)) == 1
    first = jobs(folder)[0] / "evaluation.json"
    before = first.stat().st_mtime_ns, steps[0]
    sweep("seed=0,1,2")
    assert len(jobs(folder)) == 3
    assert first.stat().st_mtime_ns == before[0]
    # Three steps of the second training were left, and all six of the third.
    assert steps[0] - before[1] == 3 + 6
    assert "complete: not played again" in capfd.readouterr().out


@pytest.mark.sim
def test_a_directory_of_other_settings_is_refused(sweep: Callable[..., Path]) -> None:
    sweep("hydra.sweep.subdir=one")
    sweep("hydra.sweep.subdir=one", "evaluation.seeds=[0,1,2]")
    content = json.loads(Path("all/one/evaluation.json").read_text())
    assert len(content["runs"]) == 3
    with pytest.raises(SystemExit, match=r"loss\.gamma=0\.9, not 0\.5"):
        sweep("hydra.sweep.subdir=one", "loss.gamma=0.5")
    assert json.loads(Path("all/one/evaluation.json").read_text()) == content


@pytest.mark.sim
def test_one_job_that_fails_does_not_keep_the_others(sweep: Callable[..., Path]) -> None:
    with pytest.raises(SystemExit, match=r"trainer\.batch_size"):
        sweep("trainer.batch_size=0,8")
    assert len(jobs(Path("all"))) == 1


def composed(*overrides: str) -> DictConfig:
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        return compose("config", list(overrides), return_hydra_config=True)


TASKS = sorted(path.stem for path in (plugins.CONF / "task").glob("*.yaml"))
SHEETS = [(task, name) for task in TASKS for name in sheets.names(task)]


@pytest.mark.parametrize("name", sorted(path.stem for path in (plugins.CONF / "sweep").glob("*.yaml")))
def test_every_sweep_file_names_settings_that_exist(name: str) -> None:
    cfg = composed("+task=landing", f"+sweep={name}")
    assert cfg.hydra.sweep.dir == f"multirun/{name}"
    params = dict(cfg.hydra.sweeper.params)
    for task in params.pop("+task", "landing").split(","):
        for key in params:
            assert OmegaConf.select(composed(f"+task={task}"), key) is not None, key


def test_the_papers_table_is_trained_as_the_defaults_are() -> None:
    cfg = composed("+task=landing", "+sweep=paper")
    assert dict(cfg.hydra.sweeper.params) == {"+task": "landing,grasping", "method": "xqmap,qlearning,hra"}
    plain = composed("+task=landing")
    assert {name for name in plain if name != "hydra" and plain[name] != cfg[name]} == {"evaluation", "sheets"}


def test_sheets_are_chosen_by_name() -> None:
    assert sheets.chosen("landing", ["all"]) == sheets.names("landing") == ["crowded", "large", "light", "slopes"]
    assert sheets.chosen("grasping", ["tint"]) == ["tint"]
    with pytest.raises(UserError, match="landing has crowded, large"):
        sheets.chosen("landing", ["steep"])


@pytest.mark.sim
@pytest.mark.parametrize(("task", "name"), SHEETS)
def test_every_sheet_is_a_world_that_can_be_built(task: str, name: str) -> None:
    cfg, changed = composed(f"+task={task}"), sheets.load(task, name)
    assert set(changed) <= {"task", "evaluation"}
    assert set(changed.evaluation) <= set(cfg.evaluation)
    settings = OmegaConf.select(changed, "task.env") or {}
    assert set(settings) <= set(cfg.task.env)
    if settings:
        OmegaConf.set_struct(cfg, False)
        env = build.make_env(OmegaConf.merge(cfg, {"task": {"env": settings}}), 0)()
        assert bool(env.reset()["action_mask"].any())
        env.close()


@pytest.mark.parametrize(
    ("chosen", "key", "value"),
    [
        (
            "hydra/launcher=slurm",
            "launcher._target_",
            "hydra_plugins.hydra_submitit_launcher.submitit_launcher.SlurmLauncher",
        ),
        ("hydra/launcher=parallel", "launcher.n_jobs", 2),
        ("hydra/sweeper=search", "sweeper.direction", "maximize"),
    ],
)
def test_launchers_and_the_search_compose(chosen: str, key: str, value: object) -> None:
    cfg = composed("+task=landing", chosen)
    assert OmegaConf.select(cfg.hydra, key) == value
    for name in cfg.hydra.sweeper.params or {}:
        assert OmegaConf.select(cfg, name) is not None, name


@pytest.mark.sim
def test_a_world_that_draws_for_itself_needs_no_driver(
    sweep: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = doctor.Finding("vulkan", False, "no device that can render")
    monkeypatch.setattr(doctor, "vulkan", lambda: missing)
    assert jobs(sweep("seed=0"))
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        cfg = compose("config", ["+task=landing"])
    with pytest.raises(UserError, match="no device that can render"):
        doctor.require_rendering(build.world(cfg))
