"""Who writes to a run directory: one process at a time, and anyone can see whether there is one."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from xqmap.errors import UserError


@contextmanager
def alone(directory: Path) -> Iterator[None]:
    """Holds a run directory, so that no second process writes to it.

    Raises:
        UserError: if another process holds it, or it does not exist.
    """
    try:
        handle = os.open(directory, os.O_RDONLY)
    except FileNotFoundError:
        raise UserError(f"there is no run directory {directory}") from None
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UserError(
                f"{directory} is being written by another process: wait for it, or choose another directory"
            ) from None
        except OSError:
            pass  # a file system without locks
        yield
    finally:
        os.close(handle)


def held(directory: Path) -> bool:
    """Whether a process on this machine writes to a run directory (:func:`alone`)."""
    try:
        handle = os.open(directory, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without locks
    finally:
        os.close(handle)
    return False
