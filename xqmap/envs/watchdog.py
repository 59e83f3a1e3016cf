"""A process of its own that times the decisions of the one that started it, by the time in which that one could run:
stopped (Ctrl-Z) or asleep with the whole machine, a simulator does not hang.

It reads ``limit grace`` when a decision begins and an empty line when it is over. After ``limit`` seconds it sends a
signal; code that no signal can interrupt is ended with its process after ``grace`` more, and a line says so.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal

LATE = signal.SIGRTMIN + 5
# Seconds between two looks: the most that a sleep of the machine can be counted for.
_TICK = 0.25
_LINE = (
    "error: a decision does not end and cannot be interrupted (trainer.decision_limit): the simulator hangs; "
    "resume=DIR goes on\n"
)


def _runs(pid: int) -> bool:
    """Whether a process is not stopped, by a signal (T) or a debugger (t)."""
    with open(f"/proc/{pid}/stat", errors="replace") as file:
        return file.read().rpartition(")")[2].split()[0] not in "Tt"


def watch(pid: int, told: int) -> None:
    """Times the decisions of the process ``pid``, until its end of the pipe ``told`` is closed."""
    limit, grace, seconds, sent = 0.0, 0.0, 0.0, False
    while True:
        if select.select([told], [], [], _TICK if limit else None)[0]:
            lines = os.read(told, 1 << 16).decode().split("\n")
            if lines == [""]:
                return
            # What was begun and ended since the last look needs no watching.
            now = lines[-2].split()
            limit, grace = map(float, now) if now else (0.0, 0.0)
            seconds, sent = 0.0, False
            continue
        seconds += _TICK * _runs(pid)
        if seconds >= limit + grace:
            os.write(2, _LINE.encode())
            os.kill(pid, signal.SIGKILL)
            return
        if seconds >= limit and not sent:
            os.kill(pid, LATE)
            sent = True


if __name__ == "__main__":
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it is gone
        watch(os.getppid(), 0)
