"""Files that others wrote, read within bounds."""

from __future__ import annotations

import os
import stat
from pathlib import Path

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
        if inside is not None and not path.resolve().is_relative_to(inside.resolve()):
            raise UserError(f"{path}: a link that leads out of {inside}")
        # A pipe that nobody writes to would be waited for.
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            found = os.fstat(file.fileno())
            if not stat.S_ISREG(found.st_mode):
                raise UserError(f"{path}: not a regular file")
            if found.st_size > limit:
                raise UserError(f"{path}: larger than the {limit:,} bytes that such a file may have")
            return file.read(found.st_size)
    except FileNotFoundError:
        raise UserError(f"{path}: there is no such file") from None
    except (OSError, RuntimeError) as error:  # RuntimeError: links that lead to one another
        raise UserError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
