"""Keeps a world's failures from being more than one line: what throws, and what never ends."""

from __future__ import annotations

import faulthandler
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from xqmap.errors import UserError, WorldError

# Code that no Python signal handler can interrupt is ended with its process, this many seconds after the limit.
_GRACE = 10.0


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
        raise WorldError(f"a decision in {where} took more than {limit:g} s (trainer.decision_limit): the simulator hangs")

    timed = limit is not None and threading.current_thread() is threading.main_thread()
    try:
        if timed and limit is not None:
            before = signal.signal(signal.SIGALRM, late)
            signal.setitimer(signal.ITIMER_REAL, limit)
            # To the process's own stderr: what stands in for it (a notebook, a test) may have no file behind it.
            faulthandler.dump_traceback_later(limit + _GRACE, exit=True, file=2)
        yield
    except UserError:
        raise
    except Exception as error:
        why = " ".join(str(error).split())[:300]
        raise WorldError(f"the simulator failed in {where} ({type(error).__name__}: {why})") from error
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
            faulthandler.cancel_dump_traceback_later()
