"""Keeps a world's failures from being more than one line: what throws, and what never ends."""

from __future__ import annotations

import faulthandler
import functools
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from xqmap.errors import UserError, WorldError, brief

# Code that no Python signal handler can interrupt is ended with its process, this many seconds after the limit.
_GRACE = 10.0


@functools.cache
def _teller() -> subprocess.Popen[bytes]:
    """Makes one line for a person of the stacks that faulthandler writes to it: this process will not come to say it
    itself.
    """
    line = (
        "error: a decision does not end and cannot be interrupted (trainer.decision_limit): the simulator hangs; "
        "resume=DIR goes on"
    )
    # To the process's own stderr: what stands in for it (a notebook, a test) may have no file behind it.
    return subprocess.Popen(["sed", "-n", f"1s/.*/{line}/p"], stdin=subprocess.PIPE, stdout=2, start_new_session=True)


@contextmanager
def guarded(where: str, limit: float | None) -> Iterator[None]:
    """Runs a piece of simulation.

    Args:
        where: what messages call it (``"scene 7"``).
        limit: the most seconds it may take; None for no limit. Only a main thread can be held to it.

    Raises:
        WorldError: if the simulator throws or takes longer.
    """

    def late(number: int, frame: FrameType | None) -> None:
        raise WorldError(
            f"a decision in {where} took more than {limit:g} s (trainer.decision_limit): the simulator hangs"
        )

    timed = limit is not None and threading.current_thread() is threading.main_thread()
    try:
        if timed and limit is not None:
            before = signal.signal(signal.SIGALRM, late)
            signal.setitimer(signal.ITIMER_REAL, limit)
            teller = _teller().stdin
            assert teller is not None
            faulthandler.dump_traceback_later(limit + _GRACE, exit=True, file=teller)
        yield
    except UserError:
        raise
    except Exception as error:
        raise WorldError(f"the simulator failed in {where} ({type(error).__name__}: {brief(error, 300)})") from error
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
            faulthandler.cancel_dump_traceback_later()
