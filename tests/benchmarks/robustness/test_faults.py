"""A training in the toy world is killed, broken and starved, and loses nothing."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig

from xqmap.benchmarks.robustness import faults, interruptions
from xqmap.errors import Stopped
from xqmap.runs import checkpoint
from xqmap.trainers import training
from xqmap.trainers.callbacks import make_trainer
from xqmap.trainers.trainer import Trainer

pytestmark = pytest.mark.sim
SHORT = ("trainer.frames=27", "trainer.warmup_frames=6", "trainer.checkpoint_period=6", "collector.frames_per_batch=3")


@pytest.fixture(scope="module")
def expected() -> dict[str, str]:
    return {}


def weights(directory: Path) -> str:
    return str(checkpoint.read(directory / checkpoint.POLICY)[1]["sha256"])


def test_killed_at_any_moment_a_training_ends_as_if_it_had_not_been(
    toy_config: Callable[..., DictConfig], tmp_path: Path
) -> None:
    sabotages = [(stage, "training") for stage in interruptions.STAGES]
    result = interruptions.interrupt(toy_config(*SHORT), tmp_path, 5, sabotages)
    assert result["injected"] == result["survived"] == 8, result
    assert result["bytes_lost"] == 0
    assert result["ended_alike"] == result["runs"]


@pytest.mark.parametrize("name", faults.FAULTS)
def test_a_fault_stops_in_one_line_or_not_at_all_and_nothing_is_lost(
    name: str,
    toy_config: Callable[..., DictConfig],
    tmp_path: Path,
    expected: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cfg, directory, fault = toy_config(*SHORT), tmp_path / "run", faults.FAULTS[name]
    if not expected:
        (tmp_path / "alone").mkdir()
        trainer = make_trainer(cfg, tmp_path / "alone")
        trainer.run()
        expected["weights"] = weights(tmp_path / "alone")
    if name in faults.ON_A_DISK:
        try:
            with faults.small_disk(directory, 8):
                survived, lost, line = faults.suffer(cfg, directory, fault)
                ended = weights(directory)
        except PermissionError as error:
            pytest.skip(str(error))
    else:
        survived, lost, line = faults.suffer(cfg, directory, fault)
        ended = weights(directory)
    assert survived, line
    assert lost == 0
    assert ended == expected["weights"] or not fault.repeats


HANG = """
import collections, itertools
from xqmap.envs import guard
guard._GRACE = 0.5
with guard.guarded("scene 7", 0.5):
    collections.deque(itertools.repeat(0), maxlen=0)  # never comes back from C
"""


def test_a_simulator_that_hangs_in_native_code_is_ended_with_its_process_in_one_line() -> None:
    done = subprocess.run([sys.executable, "-c", HANG], capture_output=True, text=True, timeout=50)
    assert done.returncode == -signal.SIGKILL
    assert len(done.stderr.splitlines()) == 1
    assert "trainer.decision_limit" in done.stderr


@pytest.mark.parametrize(("number", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_signal_ends_a_training_saved_and_says_how_to_go_on(
    number: str,
    status: int,
    toy_config: Callable[..., DictConfig],
    run_directory: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run_directory.mkdir()
    cfg = toy_config(*SHORT)
    step = Trainer._step

    def signaled(self: Trainer, batch: object) -> dict[str, float]:
        if self.frames == 9:
            signal.raise_signal(signal.Signals[number])
            # Of a terminal that is gone one hears twice.
            signal.raise_signal(signal.SIGHUP)
        return step(self, batch)  # type: ignore[arg-type]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "_step", signaled)
        with pytest.raises(Stopped) as stopped:
            training.train(cfg, run_directory, None, {}, "the command")
    assert 128 + stopped.value.number == status
    assert "go on from decision 12 with: the command" in capsys.readouterr().out
    assert checkpoint.trainings(run_directory)[0].name == "training-000012.safetensors"
