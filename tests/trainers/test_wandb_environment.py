"""A run of wandb's is its directory's own, whatever another run left in the environment."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.commands import call
from tests.conftest import toy_settings
from tests.evaluation.test_results import write_run
from tests.reports.test_offline import closed
from xqmap.reports import offline
from xqmap.trainers import wandb_environment
from xqmap.trainers.logger import Log

FOREIGN = {
    "WANDB_RUN_ID": "abc",
    "WANDB_RESUME": "must",
    "WANDB_NAME": "another",
    "WANDB_PROJECT": "another",
    "WANDB_DIR": "/nowhere",
    "WANDB_SERVICE": "3-1-unix-/nowhere",
    "WANDB_SWEEP_ID": "abc",
    "WANDB_MODE": "online",
    "WANDB_SILENT": "nonsense",
    "WANDB_CONFIG": '{"seed": 7}',
    "WANDB_BASE_URL": "nonsense",
    "WANDB_HTTP_TIMEOUT": "nonsense",
    "WANDB_TAGS": "mine",
}


def test_jobs_of_one_process_have_ids_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in FOREIGN.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    ids = []
    for job in ("a", "b"):
        (tmp_path / job).mkdir()
        log = Log(tmp_path / job, toy_settings("logger.mode=offline"), ["frames"])
        log.row({"frames": 4})
        log.close()
        assert dict(os.environ) == before
        file = closed(tmp_path / job)
        assert file.stem == f"run-{log.wandb_id}"
        assert offline.read(file).config["seed"] == 0
        ids.append(log.wandb_id)
    assert len({*ids, "abc"}) == 3


def test_a_run_that_goes_on_keeps_its_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_RUN_ID", "abc")
    log = Log(tmp_path, toy_settings("logger.mode=offline"), ["frames"], wandb_id="mine")
    log.close()
    assert [file.name for file in tmp_path.glob("wandb/offline-run-*/*.wandb")] == ["run-mine.wandb"]


@pytest.mark.parametrize(
    ("told", "variable", "mode"),
    [
        ("offline", "disabled", "disabled"),
        ("online", "dryrun", "offline"),
        ("online", "disabled", "disabled"),
        ("offline", "online", "offline"),
        ("disabled", "online", "disabled"),
        ("online", "nonsense", "online"),
        ("offline", "", "offline"),
    ],
)
def test_the_environment_can_only_say_less(
    told: str, variable: str, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WANDB_MODE", variable)
    assert wandb_environment.mode(told) == mode


def test_who_one_is_speaks_where_there_is_a_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (FOREIGN | {"WANDB_API_KEY": "key", "WANDB_DATA_DIR": "/data"}).items():
        monkeypatch.setenv(name, value)
    always = {"WANDB_TAGS": "mine", "WANDB_DATA_DIR": "/data", "WANDB_ERROR_REPORTING": "false"}
    server = {"WANDB_API_KEY": "key", "WANDB_BASE_URL": "nonsense", "WANDB_HTTP_TIMEOUT": "nonsense"}
    for mode, more in {"offline": {}, "online": server}.items():
        with wandb_environment.own(tmp_path, mode):
            left = {name: value for name, value in os.environ.items() if name.startswith("WANDB_")}
        assert left == always | more | {"WANDB_DIR": str(tmp_path)}


def test_disabled_is_disabled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WANDB_MODE", "disabled")
    log = Log(tmp_path, toy_settings("logger.mode=offline"), ["frames"])
    log.row({"frames": 4})
    log.close()
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.csv"]
    write_run(tmp_path / "runs", "a", 9)
    done = call("report", "runs=runs", "log=kept", cwd=tmp_path)
    assert done.returncode != 0 and "WANDB_MODE" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "kept").exists() and not (tmp_path / "report.html").exists()
