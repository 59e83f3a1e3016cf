"""What is said to the person at the keyboard. Words may be lost where nobody can take them, work may not."""

from __future__ import annotations

import codecs
import contextlib
import errno
import io
import os
import re
import sys
import threading
import unicodedata
from types import TracebackType
from typing import Any, TextIO

_SPELLING = {"−": "-", "–": "-", "—": "-", "±": "+-", "÷": "/", "×": "x", "·": "*", "→": "->"}


def printable(text: str) -> str:
    """Text without control characters, which could move a terminal's cursor or hide what is said; line breaks stay."""
    # A color goes wholly, or its rest would stand in front of the word it was for; of others one sees what they were.
    return "".join(c if c.isprintable() or c == "\n" else " " for c in re.sub(r"\x1b\[[0-9;]*m", "", text))


def one_line(text: str) -> str:
    """Text as a single line, without control characters."""
    return " ".join(printable(text).split())


def say(*texts: str, sep: str = " ", end: str = "\n", to: TextIO | None = None) -> None:
    """Prints texts, which may hold what a stranger wrote, and at once: the only way from here to a terminal.

    Args:
        texts: to print, as :func:`printable` leaves them.
        sep: between them.
        end: behind them.
        to: a stream; standard output if not given.
    """
    print(*map(printable, texts), sep=sep, end=end, file=to, flush=True)


class _Endless(io.FileIO):
    """A file that takes whatever is written to it, also when nobody reads it any more or its disk is full."""

    _told = False

    def write(self, content: Any, /) -> int:
        try:
            # None: it is full for the moment, and nobody is waited for.
            return super().write(content) or len(content)
        except OSError as error:
            # Nobody who stopped reading, or whose terminal is gone, wants to hear of it.
            if self.fileno() == 1 and not self._told and error.errno not in (errno.EPIPE, errno.EIO):
                self._told = True
                with contextlib.suppress(OSError):
                    os.write(2, f"what is printed is lost ({os.strerror(error.errno or errno.EIO)})\n".encode())
            return len(content)


def endure() -> None:
    """Lets no standard stream end the program: one that cannot be written loses what is said, one that was closed as
    well, and a sign that its encoding does not know is spelled with others.
    """
    codecs.register_error("spelled", _spelled)
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115 (lives as long as the program)
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")
    # Not what stands in for them: a test's, a notebook's.
    if sys.stdout is sys.__stdout__:
        sys.stdout = enduring(1, sys.stdout)
    if sys.stderr is sys.__stderr__:
        sys.stderr = enduring(2, sys.stderr)


def enduring(number: int, stream: TextIO | None) -> io.TextIOWrapper:
    """What writes to the open file of that number, in the way of ``stream``, and never fails."""
    return io.TextIOWrapper(
        io.BufferedWriter(_Endless(number, "w", closefd=False)),
        encoding=getattr(stream, "encoding", None),
        errors="spelled",
        line_buffering=getattr(stream, "line_buffering", True),
        write_through=getattr(stream, "write_through", False),
    )


def pass_over_the_gone() -> None:
    """Says nothing about a neighbour that ended while it fetched what the two of them share: multiprocessing serves
    that in a thread of its own, whose stacks would go to the terminal. The loss itself is told by who needed it.
    """
    sys.excepthook = _tell_no_loss


def _tell_no_loss(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    gone = isinstance(error, (ConnectionError, EOFError))
    if not gone or threading.current_thread() is threading.main_thread():
        sys.__excepthook__(kind, error, trace)


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """A codec's error handler: é is written e, … as three dots, and what has no spelling at all as ?."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    spelled = (
        _SPELLING.get(c) or unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() or "?"
        for c in error.object[error.start : error.end]
    )
    return "".join(spelled), error.end
