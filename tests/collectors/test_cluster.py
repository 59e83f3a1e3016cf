"""Workers of a Ray cluster: quiet, and their end loses nothing."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from tensordict.nn import TensorDictSequential

from tests.collectors.test_collect import failing_env
from xqmap.collectors import collect, worker
from xqmap.config import build
from xqmap.errors import UserError, WorkerLost
from xqmap.runs import checkpoint
from xqmap.runs.run import load_run
from xqmap.trainers.callbacks import make_trainer

pytestmark = [
    pytest.mark.sim,
    pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: pip install 'xqmap[ray]'"),
]
RUNS = re.compile(r"worker \d of \d \(machine \S+, process (\d+)\) runs toy")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster that somebody else started: several trainings join it."""
    import ray  # where it is installed

    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield ray
    ray.shutdown()


@pytest.fixture
def config(toy_config: Callable[..., DictConfig]) -> Callable[..., DictConfig]:
    return lambda *overrides: toy_config("collector=ray", "collector.frames_per_batch=2", *overrides)


def test_a_worker_decides_with_the_weights_it_was_sent(config: Callable[..., DictConfig]) -> None:
    from xqmap.collectors.cluster import _Worker  # where ray is installed

    cfg, one = config(), _Worker()
    pixel_size = build.make_env(cfg, 0)().grid.pixel_size
    settings = {"frames_per_batch": 2, "trajs_per_batch": 4, "traj_format": "cat"}
    one.start(build.make_env(cfg, 0), partial(worker.policy, cfg, pixel_size, 0), settings)
    one.next()
    policy = worker.policy(cfg, pixel_size, 0)
    for parameter in policy.parameters():
        parameter.normal_(0, 0.1)
    one.learn(TensorDict.from_module(policy).data)
    batch = one.next()
    expected = policy[0].qmaps(batch.select("heightmap", "action"))["chosen_component_value"]
    assert torch.allclose(batch["chosen_component_value"], expected, atol=1e-4)


def test_a_killed_worker_and_a_failing_simulator_end_the_run_with_nothing_lost(
    cluster: Any,
    config: Callable[..., DictConfig],
    run_directory: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run_directory.mkdir()
    trainer = make_trainer(config("trainer.frames=1000", "trainer.warmup_frames=0"), run_directory)
    step, killed = trainer._step, []

    def killing(batch):  # type: ignore[no-untyped-def]
        if not killed:
            killed.extend(RUNS.findall(capfd.readouterr().err))
            os.kill(int(killed[1]), signal.SIGKILL)
        return step(batch)

    trainer._step = killing  # type: ignore[method-assign]
    with pytest.raises(WorkerLost) as lost:
        trainer.run()
    trainer.close()
    named = rf"worker 2 of 2 \(machine \S+, process {killed[1]}\) ended unexpectedly; what it said is in .* (\S+\.err)"
    told = re.fullmatch(named, str(lost.value))
    assert told and Path(told[1]).is_file(), str(lost.value)
    assert trainer.saved_frames == trainer.frames > 0
    assert cluster.is_initialized()

    # It goes on, until a simulator fails.
    monkeypatch.setattr(build, "make_env", lambda cfg, first_scene: partial(failing_env, cfg, first_scene))
    saved = checkpoint.read_training(run_directory)
    second = make_trainer(
        config("trainer.frames=1000", "trainer.warmup_frames=0", "collector.workers=1"), run_directory, saved
    )
    assert len(second.replay) == trainer.frames
    with pytest.raises(WorkerLost) as failed:
        second.run()
    second.close()
    told = re.search(r"failed \((the simulator failed in scene .*)\); .* (\S+\.err)$", str(failed.value))
    assert told and "the solver did not converge" in told[1], str(failed.value)
    assert "Traceback" in Path(told[2]).read_text()
    assert len(second.replay) == second.frames == second.saved_frames > trainer.frames
    assert second.updates > trainer.updates
    load_run(run_directory)


def test_a_cluster_with_too_few_cpus_or_none_is_named(
    cluster: Any,
    config: Callable[..., DictConfig],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    from xqmap.collectors.cluster import _require  # where ray is installed

    def collector(*overrides: str) -> Any:
        cfg = config(*overrides)
        return collect.collector(cfg, build.make_env(cfg, 0)(), TensorDictSequential(), made=0)

    with pytest.raises(UserError, match=r"collector\.workers=3, but the Ray cluster has 2 CPUs"):
        collector("collector.workers=3")
    monkeypatch.setattr(cluster, "available_resources", lambda: {"CPU": 1.0})
    _require(2)
    assert "waiting for 2 CPUs of the Ray cluster, 1 of 2 are free" in capfd.readouterr().err
    monkeypatch.setattr(cluster, "is_initialized", lambda: False)
    monkeypatch.setattr(cluster, "shutdown", lambda: None)
    monkeypatch.setattr(cluster, "init", lambda *a, **k: (_ for _ in ()).throw(ConnectionError("timed\nout")))
    monkeypatch.setenv("RAY_ADDRESS", "10.0.0.5:6379")
    with pytest.raises(UserError, match=r"no cluster \(timed out\): .* RAY_ADDRESS=10\.0\.0\.5:6379"):
        collector()


def test_an_interrupted_run_is_quiet_saves_and_leaves_no_process(tmp_path: Path) -> None:
    settings = ["+task=toy", "trainer.frames=100000", "collector=ray", "collector.workers=1"]
    command = [sys.executable, "-m", "xqmap.train", *settings, "logger.mode=disabled", "hydra.run.dir=run"]
    told = tmp_path / "told"
    with open(told, "wb") as file:
        running = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, stdout=file, stderr=file)
    try:
        metrics, deadline = tmp_path / "run" / "metrics.csv", time.monotonic() + 240
        while running.poll() is None and time.monotonic() < deadline:
            if metrics.exists() and len(metrics.read_text().splitlines()) > 1:
                break
            time.sleep(0.1)
        os.killpg(running.pid, signal.SIGINT)
        assert running.wait(60) == 130
        # A worker leads a process group of its own; all are of the command's session.
        assert not _until_none(lambda: _session(running.pid))
    finally:
        for process in {running.pid, *_session(running.pid)}:
            if running.poll() is None or process != running.pid:
                os.kill(process, signal.SIGKILL)
    lines = [line for line in re.split(r"[\r\n]+", told.read_text()) if line and not line.startswith("training:")]
    assert len([line for line in lines if RUNS.fullmatch(line)]) == 1, lines
    ours = r"stopping when this step is saved.*|\d+ decisions and \d+ updates.*|stopped; go on from decision.*"
    assert not [line for line in lines if not re.fullmatch(rf"{RUNS.pattern}|{ours}|\s+", line)], lines
    assert (tmp_path / "run" / checkpoint.POLICY).exists()


def _session(leader: int) -> list[int]:
    """The processes of a session, the dead left out."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(session) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def _until_none(find: Callable[[], list[int]], seconds: float = 10.0) -> list[int]:
    deadline = time.monotonic() + seconds
    while (found := find()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return found
