"""What a command (``python -m xqmap.COMMAND``) sees to before it imports anything that takes time."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from types import FrameType


def imported() -> None:
    """Leaves Ctrl-C to Python again."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def stopping() -> list[signal.Signals]:
    """What asks a program to stop, besides Ctrl-C: SIGHUP only where it was not started to survive that (``nohup``)."""
    survived = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGTERM] if survived else [signal.SIGTERM, signal.SIGHUP]


def _end(number: int, frame: FrameType | None) -> None:
    """Ends the program in one line: no library on the way gets to tell its stacks, or to go on."""
    with contextlib.suppress(OSError):
        os.write(2, b"stopped\n")
    os._exit(128 + number)


def _occupy() -> None:
    """Gives the empty device the numbers of standard streams that are closed: the next file that is opened would take
    one, and get what is said.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)


def _command() -> bool:
    told = sys.orig_argv
    return "-m" in told[:-1] and told[told.index("-m") + 1].startswith(f"{__package__}.")


if _command():
    _occupy()
    # A background job, which hears no Ctrl-C, is left as it is.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
