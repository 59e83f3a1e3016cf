"""Workers make decisions with the weights the trainer has now, in scenes of their own, and their end is one clear
line.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictSequential

from tests.trainers.test_training import train
from xqmap.collectors import collect
from xqmap.config import build
from xqmap.errors import UserError, WorkerLost
from xqmap.models.policy import GreedyPolicy
from xqmap.runs import checkpoint
from xqmap.runs.run import load_run
from xqmap.trainers.callbacks import make_trainer

pytestmark = pytest.mark.sim
make_env = build.make_env


def failing_env(cfg: DictConfig, first_scene: int) -> Any:
    """A world that fails in its ninth decision."""
    env = make_env(cfg, first_scene)()
    step, made = env.task.step, iter(range(9))

    def failing(action: Any) -> Any:
        if next(made) == 8:
            raise RuntimeError("the solver did not converge")
        return step(action)

    env.task.step = failing
    return env


@pytest.fixture
def config(toy_config: Callable[..., DictConfig]) -> Callable[..., DictConfig]:
    return lambda *overrides: toy_config("collector=parallel", "collector.frames_per_batch=2", *overrides)


def test_workers_get_new_weights_and_see_different_scenes(config: Callable[..., DictConfig]) -> None:
    cfg = config()
    env = make_env(cfg, 0)()
    network = build.qmaps(cfg, env.grid.pixel_size)
    policy = TensorDictSequential(GreedyPolicy(network), build.exploration(cfg))
    source = collect.collector(cfg, env, policy, made=0)
    try:
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.normal_(0, 0.1)
        collect.share(source, policy)
        seen, agree = [], False
        for count, batch in enumerate(collect.batches(source, cfg.collector)):
            assert bool(batch["next", "done"][-1])
            seen.append(batch["heightmap"][:, :3].amax((1, 2, 3)))
            with torch.no_grad():
                expected = network(batch.select("heightmap", "action"))["chosen_component_value"]
            agree = agree or torch.allclose(batch["chosen_component_value"], expected, atol=1e-4)
            if count == 4:
                break
        assert agree
        assert len(torch.cat(seen).unique()) > 4
    finally:
        collect.close(source, alone=False)


def test_a_parallel_run_trains_goes_on_and_loses_nothing_stored(
    config: Callable[..., DictConfig], run_directory: Path
) -> None:
    first = train(config("replay=prioritized", "trainer.frames=24"), run_directory)
    stored = len(first.replay)
    assert first.frames == stored >= 24
    assert first.updates > 0
    tensors, facts = checkpoint.read_training(run_directory)
    facts["config"]["trainer"]["frames"] = 40
    second = make_trainer(config("replay=prioritized", "trainer.frames=40"), run_directory, (tensors, facts))
    assert len(second.replay) == stored
    assert all(torch.equal(value, second.replay.contents()[name]) for name, value in first.replay.contents().items())
    second.run()
    second.close()
    assert len(second.replay) == second.frames >= 40


def test_a_dead_worker_is_named_and_what_was_learned_is_saved(
    config: Callable[..., DictConfig], run_directory: Path
) -> None:
    run_directory.mkdir()
    trainer = make_trainer(config("trainer.frames=1000"), run_directory)
    step = trainer._step

    def killing(batch):  # type: ignore[no-untyped-def]
        if trainer.frames == 0:
            children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
            workers = [pid for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
            os.kill(int(workers[-1]), signal.SIGKILL)
        return step(batch)

    trainer._step = killing  # type: ignore[method-assign]
    with pytest.raises(WorkerLost, match="worker"):
        trainer.run()
    trainer.close()
    assert trainer.saved_frames == trainer.frames > 0
    load_run(run_directory)


def test_what_a_dead_worker_never_read_does_not_hold_up_the_end() -> None:
    scheme, queue = collect._Unheard(sync=False), torch.multiprocessing.get_context("spawn").Queue()
    queue.put(bytes(2**20))
    scheme._instruction_queues[0] = queue
    ending = threading.Thread(target=scheme.shutdown, daemon=True)
    ending.start()
    ending.join(30)
    assert not ending.is_alive()


def test_workers_in_step_repeat_bit_by_bit(config: Callable[..., DictConfig], tmp_path: Path) -> None:
    # An odd number of decisions a round: episodes of two are cut by it and put together again.
    settings = (
        "collector=ordered",
        "collector.frames_per_batch=3",
        "collector.episodes_per_batch=3",
        "trainer.frames=24",
    )
    first, second = (train(config(*settings, "trainer.warmup_frames=6"), tmp_path / name) for name in "ab")
    assert first.updates > 0
    shas = [load_run(tmp_path / name).sha256 for name in "ab"]
    assert shas[0] == shas[1]
    scenes = [trained.replay.contents()["state.color"] for trained in (first, second)]
    assert torch.equal(*scenes)
    assert len(scenes[0][::2].unique(dim=0)) > 4


def test_a_simulator_that_fails_in_a_worker_ends_the_run_saved(
    config: Callable[..., DictConfig],
    run_directory: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(build, "make_env", lambda cfg, first_scene: partial(failing_env, cfg, first_scene))
    run_directory.mkdir()
    trainer = make_trainer(config("collector=ordered", "trainer.frames=1000"), run_directory)
    with pytest.raises(WorkerLost, match="worker"):
        trainer.run()
    trainer.close()
    assert trainer.saved_frames == trainer.frames > 0
    load_run(run_directory)
    assert "error in a worker: the simulator failed in scene" in (told := capfd.readouterr().err)
    assert "Traceback" not in told


def test_what_ends_the_workers_is_one_line(config: Callable[..., DictConfig]) -> None:
    class Died(Exception):
        """As Ray's own, of no other kind."""

    def fail(*args: Any) -> Any:
        raise Died("the node timed out\nduring startup")

    with pytest.raises(WorkerLost, match="the node timed out during startup"):
        next(collect.batches(map(fail, [0]), config("collector=ray").collector))  # type: ignore[arg-type]


def test_ray_is_asked_for_by_name(config: Callable[..., DictConfig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(collect, "find_spec", lambda name: None)
    cfg = config("collector=ray")
    env = make_env(cfg, 0)()
    with pytest.raises(UserError, match=r"xqmap\[ray\]"):
        collect.collector(cfg, env, TensorDictSequential(), made=0)


def test_an_interrupted_parallel_run_saves_and_leaves_no_process(tmp_path: Path) -> None:
    settings = [
        "+task=toy",
        "trainer=smoke",
        "trainer.frames=100000",
        "collector=parallel",
        "logger.mode=disabled",
        "hydra.run.dir=run",
    ]
    command = [sys.executable, "-m", "xqmap.train", *settings]
    running = subprocess.Popen(command, cwd=tmp_path, start_new_session=True, stderr=subprocess.PIPE)
    try:
        metrics, deadline = tmp_path / "run" / "metrics.csv", time.monotonic() + 120
        while (
            running.poll() is None
            and time.monotonic() < deadline
            and not (metrics.exists() and len(metrics.read_text().splitlines()) > 1)
        ):
            time.sleep(0.2)
        os.killpg(running.pid, signal.SIGINT)
        _, told = running.communicate(timeout=60)
    finally:
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGKILL)
    assert running.returncode == 130
    assert b"Traceback" not in told
    assert (tmp_path / "run" / checkpoint.POLICY).exists()
    with pytest.raises(ProcessLookupError):
        for _ in range(50):
            os.killpg(running.pid, 0)
            time.sleep(0.1)


_HUNG_UP = """
import os, signal, time
from multiprocessing import resource_tracker
from xqmap.collectors import collect
collect.outlive_the_terminal()
keeper = resource_tracker._resource_tracker._pid
os.kill(keeper, signal.SIGHUP)
time.sleep(0.5)
assert os.waitpid(keeper, os.WNOHANG) == (0, 0)
"""


def test_the_book_keeper_of_all_processes_outlives_the_terminal() -> None:
    done = subprocess.run([sys.executable, "-c", _HUNG_UP], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
