"""Keeps a world's failures from being more than one line: what throws, and what never ends."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from xqmap.envs import watchdog
from xqmap.errors import TRACEBACK, UserError, WorldError, brief

# Code that no Python signal handler can interrupt is ended with its process, this many seconds after the limit.
_GRACE = 10.0


class _Watch:
    """This process's watchdog, and the decision that it times now."""

    def __init__(self) -> None:
        self.pid = 0
        self.dog: subprocess.Popen[bytes] | None = None
        self.where, self.limit, self.begun = "", 0.0, 0.0

    def begin(self, where: str, limit: float) -> None:
        """Starts to time a decision; only in a main thread."""
        # Not one of the process that this one was forked from.
        if self.dog is None or self.pid != os.getpid() or self.dog.poll() is not None:
            signal.signal(watchdog.LATE, self._late)
            self.pid = os.getpid()
            if self.dog is not None and self.dog.stdin is not None:
                self.dog.stdin.close()
            # To the process's own stderr: what stands in for it (a notebook, a test) may have no file behind it.
            self.dog = subprocess.Popen(
                [sys.executable, "-I", "-S", watchdog.__file__], stdin=subprocess.PIPE, stdout=2, start_new_session=True
            )
        self.where, self.limit, self.begun = where, limit, time.monotonic()
        self._tell(f"{limit} {_GRACE}\n")

    def end(self) -> None:
        """The decision is over."""
        self.limit = 0.0
        self._tell("\n")

    def leave(self) -> None:
        """This process ends, and its watchdog with it."""
        if self.dog is not None and self.pid == os.getpid():
            with self.dog:
                self.dog.kill()

    def _tell(self, line: str) -> None:
        assert self.dog is not None and self.dog.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the next decision gets another one
            os.write(self.dog.stdin.fileno(), line.encode())

    def _late(self, number: int, frame: FrameType | None) -> None:
        # It may have been sent for a decision that is over by now.
        limit = self.limit
        if limit and time.monotonic() - self.begun >= limit:
            self.end()
            raise WorldError(
                f"a decision in {self.where} took more than {limit:g} s (trainer.decision_limit): the simulator hangs"
            )


_watch = _Watch()
atexit.register(_watch.leave)


@contextmanager
def guarded(where: str, limit: float | None) -> Iterator[None]:
    """Runs a piece of simulation.

    Args:
        where: what messages call it (``"scene 7"``).
        limit: the most seconds it may take, not counting those in which the process is stopped; None for no limit. Only
            a main thread can be held to it.

    Raises:
        WorldError: if the simulator throws or takes longer.
    """
    timed = threading.current_thread() is threading.main_thread()
    try:
        if timed and limit is not None:
            _watch.begin(where, limit)
        yield
    except UserError:
        raise
    except Exception as error:
        raise WorldError(
            f"the simulator failed in {where} ({type(error).__name__}: {brief(error, 300)}); "
            f"{TRACEBACK}=1 shows its traceback"
        ) from error
    finally:
        if timed and limit is not None:
            _watch.end()
