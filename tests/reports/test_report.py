"""From a folder of runs to a page: what training logs comes back as it was, and nothing that lies among the runs breaks
the report.
"""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from tests.browser import everything_is_drawn, opened, table
from tests.commands import call
from tests.conftest import toy_settings
from tests.evaluation.test_results import write_run
from xqmap import explain
from xqmap.evaluation import results
from xqmap.evaluation.run import evaluate_run
from xqmap.explanations import Candidate, Decision
from xqmap.reports import curves, offline
from xqmap.reports.runs import Run, gather
from xqmap.runs import locks
from xqmap.runs.run import load_run
from xqmap.trainers.callbacks import make_trainer


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Two tasks, two methods, three seeds, trained in the toy world; one decision of each task explained."""
    root = tmp_path_factory.mktemp("sweep")
    for task in ("red", "blue"):
        for method in ("xqmap", "qlearning"):
            for seed in range(3):
                cfg = toy_settings(
                    f"method={method}",
                    f"seed={seed}",
                    "logger.mode=offline",
                    "trainer.frames=24",
                    "evaluation.seeds=[0]",
                )
                cfg.task.name = task
                directory = root / f"{task}-{method}-{seed}"
                (directory / ".hydra").mkdir(parents=True)
                OmegaConf.save(cfg, directory / ".hydra" / "config.yaml")
                trainer = make_trainer(cfg, directory)
                trainer.run()
                trainer.close()
                result = evaluate_run(directory, cfg.evaluation, directory / "evaluation.json")
                known = dict.fromkeys(("bias", "mae", "rank_correlation", "sign_accuracy"), 0.25)
                extra = {
                    "confusion": {"red patch": {"red patch": 2}},
                    "calibration": {"exact": {"left": known}, "returns": {}},
                }
                (directory / "evaluation.json").write_text(json.dumps(result | extra))
        run = load_run(root / f"{task}-xqmap-0")
        perception = OmegaConf.create({"_target_": "xqmap.explanations.perception.Simulator"})
        explain.write(run.episode(5, 1, perception)[0], run.directory / "figures" / "scene5")
    yield root


@pytest.mark.sim
def test_what_training_logs_comes_back_as_in_metrics_csv(sweep: Path) -> None:
    directory = sweep / "red-xqmap-1"
    logged = offline.read(next(directory.rglob("*.wandb")))
    assert (logged.exit_code, logged.trouble) == (0, "")
    assert logged.config["task"]["name"] == "red"
    assert {"host", "os", "python", "started_at"} <= set(logged.environment)
    with open(directory / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    for name in rows[0]:
        ours = [float(row[name]) if row[name] else math.nan for row in rows]
        assert logged.columns[name] == pytest.approx(ours, nan_ok=True), name
    assert logged.pictures
    assert all(path.suffix == ".png" for path in logged.pictures.values())


@pytest.mark.sim
def test_a_sweep_becomes_a_page_that_a_browser_shows(sweep: Path, tmp_path: Path) -> None:
    done = call("report", f"runs={sweep}", "out=report.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "wrote report.html" in done.stdout
    with opened(tmp_path / "report.html") as page:
        assert page.title() == "xqmap: 12 trainings of 2 tasks"
        rows = {(row["task"], row["method"]): row for row in table(page)}
        assert len(rows) == 2 * (2 + 4)
        for row in results.table(results.collect(sweep)[0]):
            assert rows[row.task, row.name]["best choices"] == f"{100 * row.mean:.1f} %"
        assert rows["red", "oracle"]["best choices"] == "100.0 %"
        page.get_by_role("button", name="best choices").first.click()
        rates = [float(row["best choices"].rstrip(" %")) for row in table(page)]
        assert rates == sorted(rates)
        # Per task: a chart of intervals, 5 groups of curves, shares of time, a decision's bars.
        everything_is_drawn(page, charts=2 * 8, pictures=2 * 3)
        assert page.get_by_text("I chose the").count() >= 2
        assert page.get_by_role("cell", name="exact value").count() == 12
        assert page.get_by_role("heading", name="Chosen and best: xqmap").count() == 2
        page.emulate_media(color_scheme="dark")
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(22, 25, 29)"


def test_nothing_among_the_runs_breaks_the_report(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    write_run(root, "good<b>", 9)
    script = """
import os, signal, sys, time
from pathlib import Path
from tests.conftest import toy_settings
from xqmap.trainers.logger import Log
cfg = toy_settings("logger.mode=offline", "trainer.frames=1000")
directory = Path(sys.argv[1]); directory.mkdir()
log = Log(directory, cfg, ["frames", "seconds", "success"])
for i in range(1, 400):
    log.row({"frames": 4 * i, "seconds": i, "success": 0.5})
time.sleep(1)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", script, str(root / "killed")], timeout=120, capture_output=True)
    assert done.returncode == -9, done.stderr
    foreign = """
import sys, wandb
settings = wandb.Settings(x_disable_stats=True, console="off", silent=True)
run = wandb.init(mode="offline", dir=sys.argv[1], config={"lr": 1}, settings=settings)
run.log({"accuracy": 1}); run.finish()
"""
    (root / "other").mkdir()
    assert (
        subprocess.run(
            [sys.executable, "-c", foreign, str(root / "other")], timeout=120, capture_output=True
        ).returncode
        == 0
    )
    source = next((root / "killed").rglob("*.wandb"))
    for name, size in {"half": source.stat().st_size // 2, "empty": 0, "header": 3}.items():
        folder = root / name / "wandb" / "offline-run-1"
        folder.mkdir(parents=True)
        (folder / "run-1.wandb").write_bytes(source.read_bytes()[:size])

    runs, left_out = gather(root, results.collect(root)[0])
    states = {run.name: run.state for run in runs}
    assert states["good<b>"] == "finished"
    assert re.fullmatch(r"broke off at [\d,]+ of 1,000 decisions", states["killed"])
    assert re.fullmatch(r"broke off at [\d,]+ of 1,000 decisions", states["half"])
    assert {path.name for path in left_out} == {"other", "empty", "header"}
    done = call("report", f"runs={root}", "out=page.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    html = (tmp_path / "page.html").read_text()
    assert "good&lt;b&gt;" in html
    assert "<b>" not in html
    assert "broke off at" in html
    for name in ("other", "empty", "header"):
        assert f"left out: {root / name}" in done.stdout


def test_the_table_alone_with_its_pictures_and_mistakes(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "runs", "a", 9)
    values = [Candidate("Selected", "red block", {"color": 1.0}), Candidate("A", "gray block", {"color": 0.0})]
    Decision("landing", ("color",), values).save(folder / "figures" / "scene7" / "decision.json")
    done = call("report", "runs=runs", "format=md", "out=table.md", "figures=docs", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| landing | xqmap | 90.0 % |" in (tmp_path / "table.md").read_text()
    assert {path.name for path in (tmp_path / "docs").iterdir()} == {
        f"landing{n}.{k}" for n in ("", "-choices") for k in ("png", "svg")
    }
    assert call("report", "runs=runs", "format=csv", cwd=tmp_path).returncode == 0
    assert next(csv.DictReader((tmp_path / "report.csv").read_text().splitlines()))["mean"] == "0.9"
    (tmp_path / "nothing").mkdir()
    for arguments, named in {
        ("runs=nothing",): "holds no run",
        ("runs=nothing", "format=csv"): "evaluation.json",
        ("runs=x",): "no directory",
    }.items():
        done = call("report", *arguments, cwd=tmp_path)
        assert done.returncode != 0
        assert done.stderr.strip().splitlines()[-1].startswith("error: ")
        assert named in done.stderr
    assert not (tmp_path / "report.html").exists()


def test_sheets_are_chosen(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "runs", "a", 9)
    for name in ("hard", "odd"):
        (folder / f"evaluation-{name}.json").write_text((folder / "evaluation.json").read_text())
    for wanted, there in {"[]": set(), "hard": {"hard"}, "[hard,odd]": {"hard", "odd"}}.items():
        assert call("report", "runs=runs", "format=csv", f"sheets={wanted}", cwd=tmp_path).returncode == 0
        assert {row["sheet"] for row in csv.DictReader((tmp_path / "report.csv").read_text().splitlines())} == {
            "",
            *there,
        }
    done = call("report", "runs=runs", "sheets=[easy]", cwd=tmp_path)
    assert done.returncode != 0
    assert "'easy'; these runs were evaluated on hard, odd" in done.stderr


def test_a_run_that_is_being_written_is_not_broken(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "config.yaml").write_text(
        "{task: {name: landing}, method: {name: xqmap}, trainer: {frames: 40}}"
    )
    (folder / "metrics.csv").write_text("frames,seconds\n4,1\n8,2\n12,1\n")
    (folder / ".hydra" / "overrides.yaml").write_text("- +task=landing\n")
    with locks.alone(folder):
        (run,), _ = gather(tmp_path, [])
    assert run.state == "running, at 12 of 40 decisions"
    assert run.overrides == ["+task=landing"]
    # Resumed after the second row, whose seconds count.
    assert run.columns["seconds"].tolist() == [1, 2, 3]
    (run,), _ = gather(tmp_path, [])
    assert run.state == "stopped at 12 of 40 decisions"


def test_curves_end_with_the_first_finished_training() -> None:
    def run(end: int, value: float, wanted: int) -> Run:
        frames = np.arange(4.0, end + 1, 4)
        run = Run("a", Path(), {"trainer.frames": wanted}, {"frames": frames, "loss/x": np.full(len(frames), value)})
        run.result = results.Result(Path(), "", {"task": "t", "method": "m"})
        return run

    whole = [run(4000, 1.0, 4000), run(4000, 3.0, 4000)]
    line = curves.curve(whole, "loss/x", "frames")
    assert line is not None
    assert line.x[-1] == pytest.approx(4000, rel=0.01)
    assert (line.mean == 2.0).all() and (line.low == 1.0).all() and (line.high == 3.0).all()
    broken = curves.curve([*whole, run(2000, 8.0, 4000)], "loss/x", "frames")
    assert broken is not None
    assert (broken.mean[0], broken.mean[-1]) == (4.0, 2.0)
    assert curves.curve(whole, "loss/y", "frames") is None


def test_a_resumed_run_is_one_curve(tmp_path: Path) -> None:
    from xqmap.reports.runs import _joined

    first = {"frames": np.array([4.0, 8.0, 12.0]), "seconds": np.array([1.0, 2.0, 3.0]), "a": np.array([1.0, 2.0, 3.0])}
    second = {"frames": np.array([12.0, 16.0]), "seconds": np.array([1.0, 2.0]), "b": np.array([5.0, 6.0])}
    joined = _joined(first, second)
    assert joined["frames"].tolist() == [4, 8, 12, 16]
    assert joined["seconds"].tolist() == [1, 2, 3, 4]
    assert joined["a"][:2].tolist() == [1, 2] and np.isnan(joined["a"][2:]).all()


def test_the_page_is_kept_as_a_wandb_run_and_is_no_training(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", "a", 9)
    done = call("report", "runs=runs", "log=runs/report", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (kept,) = (tmp_path / "runs" / "report").glob("wandb/offline-run-*")
    assert f"logged it to {kept.relative_to(tmp_path)}" in done.stdout.replace(f"{tmp_path}/", "")
    (page,) = kept.glob("files/media/html/*.html")
    assert page.read_bytes() == (tmp_path / "report.html").read_bytes()
    runs, left_out = gather(tmp_path / "runs", results.collect(tmp_path / "runs")[0])
    assert ([run.name for run in runs], left_out) == (["a"], {})
    done = call("report", "runs=runs", "format=md", "log=x", cwd=tmp_path)
    assert done.returncode != 0 and "format=html" in done.stderr


def test_wandb_would_sync_a_run(tmp_path: Path) -> None:
    from xqmap.trainers.logger import Log

    log = Log(tmp_path, toy_settings("logger.mode=offline"), ["frames"])
    log.row({"frames": 4})
    log.close()
    log_file = next(tmp_path.glob("wandb/offline-run-*/*.wandb"))
    command = [sys.executable, "-m", "wandb", "sync", "--dry-run", str(log_file.parent)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "Would sync 1 run" in done.stderr
    assert log_file.name in done.stderr
