"""Files: those that others wrote are read within bounds, our own are written completely or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from xqmap.errors import UserError


def read_bytes(path: Path, limit: int, inside: Path | None = None) -> bytes:
    """The content of a regular file.

    Args:
        path: of the file.
        limit: bytes it may have.
        inside: the directory that it has to lie in, wherever links lead; None for any place.

    Raises:
        UserError: naming the file and what is wrong with it.
    """
    try:
        with opened(path, limit, inside) as file:
            return file.read(limit)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from None


def opened(path: Path, limit: int, inside: Path | None = None) -> BinaryIO:
    """A regular file to read from, as :func:`read_bytes` takes it.

    Raises:
        UserError: naming the file and what is wrong with it.
    """
    try:
        if inside is not None and not path.resolve().is_relative_to(inside.resolve()):
            raise UserError(f"{path}: a link that leads out of {inside}")
        # A pipe that nobody writes to would be waited for.
        file = open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb")  # noqa: SIM115 (the caller closes it)
        found = os.fstat(file.fileno())
        if stat.S_ISREG(found.st_mode) and found.st_size <= limit:
            return file
        file.close()
        if stat.S_ISREG(found.st_mode):
            raise UserError(f"{path}: larger than the {limit:,} bytes that such a file may have")
        raise UserError(f"{path}: not a regular file")
    except FileNotFoundError:
        raise UserError(f"{path}: there is no such file") from None
    except (OSError, RuntimeError, ValueError) as error:  # links that lead to one another; a name with a zero byte
        raise UserError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A new file beside ``path`` to write to; it is moved to ``path`` when complete, and gone if that fails.

    A reader finds the old file or the new one, never half of one. The name beside cannot be foreseen and is opened
    exclusively: in a stranger's directory a link that waits there would lead the content elsewhere.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=f".part{path.suffix}")
    beside = Path(name)
    try:
        os.close(handle)
        yield beside
        # As open() would have made it; mkstemp's files, and those of safetensors, are the owner's alone.
        os.chmod(beside, 0o666 & ~_umask())
        with open(beside, "rb") as file:
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


def forget_unfinished(folder: Path) -> None:
    """Removes what :func:`replacing` left in ``folder`` where its process was killed; nobody else may be writing."""
    for path in folder.glob(".*.part*"):
        path.unlink(missing_ok=True)


def _umask() -> int:
    """What new files are not allowed; there is no way to ask but to set it."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def require_place(path: Path) -> Path:
    """``path``, if a file can be put there: to be asked before the work whose result it is to hold.

    Raises:
        OSError: if it cannot.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    nearest = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            return path
    except OSError as error:
        raise OSError(error.errno, os.strerror(error.errno or errno.EIO), str(path)) from None


def write_atomically(path: Path, content: bytes) -> None:
    """Puts ``content`` at ``path`` completely or not at all."""
    with replacing(path) as beside:
        beside.write_bytes(content)
