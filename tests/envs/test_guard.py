"""A decision's limit counts the time in which it could go on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from xqmap.envs import guard
from xqmap.errors import WorldError

STOPPED = """
import sys
from xqmap.envs import guard
guard._GRACE = 0.2
with guard.guarded("scene 7", 1.5):
    print("begun", flush=True)
    sys.stdin.readline()
    print("over", flush=True)
with guard.guarded("scene 8", 1.5):
    sys.stdin.readline()
"""


def test_a_sleep_is_not_counted_and_a_hang_after_it_is() -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    command = [sys.executable, "-c", STOPPED]
    with subprocess.Popen(command, text=True, **pipes) as process:  # type: ignore[call-overload]
        assert process.stdout.readline() == "begun\n"
        os.kill(process.pid, signal.SIGSTOP)
        time.sleep(2.5)  # longer than limit and grace
        os.kill(process.pid, signal.SIGCONT)
        time.sleep(0.3)  # what waited for it to go on has its turn
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.stdout.readline() == "over\n"
        assert "a decision in scene 8 took more than 1.5 s (trainer.decision_limit)" in process.stderr.read()
        assert process.wait() == 1


def test_limits_follow_one_another() -> None:
    for scene in range(3):
        with guard.guarded(f"scene {scene}", 0.5):
            pass
    first = guard._watch.dog
    with pytest.raises(WorldError, match=r"scene 4 took more than 0\.5 s"), guard.guarded("scene 4", 0.5):
        time.sleep(30)
    # What was late is over: nothing of it hits the next, and not what has no limit.
    with guard.guarded("scene 5", 60):
        time.sleep(0.6)
    with guard.guarded("scene 6", None):
        time.sleep(0.1)
    assert guard._watch.dog is first
    # One that is gone is replaced.
    first.kill()
    first.wait()
    with pytest.raises(WorldError, match="scene 7 took"), guard.guarded("scene 7", 0.5):
        time.sleep(30)


def test_what_throws_is_told_with_its_scene() -> None:
    with pytest.raises(WorldError, match=r"scene 7 \(RuntimeError: no solution\)"), guard.guarded("scene 7", 5):
        raise RuntimeError("no\x1b[31m \x07solution")
