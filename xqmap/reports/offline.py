"""Reads a wandb run's file: a log of records in LevelDB's framing, each one of wandb's own protobuf messages.

wandb's command for it (``wandb leet inspect --json``) says the same, for two processes and a second of processor time a
file: minutes for a large sweep.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from wandb.proto import wandb_internal_pb2

from xqmap.errors import UserError, brief
from xqmap.files import read_bytes

# Bytes of a file, and numbers in it: a training logs some thirty a row.
_LARGEST_FILE = 500_000_000
MOST_NUMBERS = 20_000_000
# https://github.com/google/leveldb/blob/main/doc/log_format.md, behind seven bytes of wandb's.
_MAGIC = b":W&B\xe1\xbe"
_BLOCK = 32768
_HEAD = struct.Struct("<IHB")
_FULL, _FIRST, _LAST = 1, 2, 4


@dataclass
class Logged:
    """What one ``.wandb`` file tells.

    Attributes:
        path: the file.
        config: the settings the run was started with.
        environment: host, os, python, git and the like, as wandb found them.
        columns: metrics by name, ``[T]`` each, NaN where a row has none.
        pictures: the last picture file logged at each step.
        exit_code: None if the run never said that it ended.
        trouble: what can be said against the file; empty if nothing.
    """

    path: Path
    config: dict[str, Any] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    pictures: dict[int, Path] = field(default_factory=dict)
    exit_code: int | None = None
    trouble: str = ""


def read(path: Path) -> Logged:
    """Reads one file as far as it goes: a killed run's ends at the last flush."""
    logged, rows = Logged(path), 0
    columns: dict[str, array[float]] = {}
    try:
        content = read_bytes(path, _LARGEST_FILE, inside=path.parent)
        if not content.startswith(_MAGIC[: len(content)]):
            raise UserError("not a file of wandb's")
        for record in _records(content, logged):
            kind = record.WhichOneof("record_type")
            if kind == "history":
                item = _plain(record.history.item)
                _add(item, columns, rows)
                _picture(item, logged)
                rows += 1
            elif kind == "run":
                logged.config |= _plain(record.run.config.update)
            elif kind == "environment":
                logged.environment |= _environment(record.environment)
            elif kind == "exit":
                logged.exit_code = record.exit.exit_code
            if rows * len(columns) > MOST_NUMBERS:
                columns.clear()
                raise UserError(f"more than the {MOST_NUMBERS:,} numbers that a training may log")
    except UserError as error:
        logged.trouble = str(error).removeprefix(f"{path}: ")
    except Exception as error:  # of protobuf, of json: whatever a stranger's file provokes
        logged.trouble = f"not what a training logs ({brief(error, 80)})"
    if logged.exit_code is None and not logged.trouble:
        logged.trouble = "reached the end of an incomplete file (the run may still be active or was interrupted)"
    for name, values in sorted(columns.items()):
        logged.columns[name] = np.array([*values, *[math.nan] * (rows - len(values))])
    return logged


def _records(content: bytes, logged: Logged) -> Iterator[Any]:
    """The records of a file; what is damaged is skipped up to its block's end, and noted in ``logged.trouble``."""
    at, parts = len(_MAGIC) + 1, None
    while at + _HEAD.size <= len(content):
        left = _BLOCK - at % _BLOCK
        if left < _HEAD.size:
            at += left
            continue
        checksum, size, kind = _HEAD.unpack_from(content, at)
        piece = content[at + _HEAD.size : at + _HEAD.size + size]
        if len(piece) < size:
            return
        if zlib.crc32(piece, zlib.crc32(bytes([kind]))) != checksum:
            logged.trouble, parts = "damaged, some of it was skipped", None
            at += left
            continue
        at += _HEAD.size + size
        parts = [piece] if kind in (_FULL, _FIRST) else parts and [*parts, piece]
        if parts and kind in (_FULL, _LAST):
            yield wandb_internal_pb2.Record.FromString(b"".join(parts))  # type: ignore[attr-defined]
            parts = None


def _environment(record: Any) -> dict[str, Any]:
    """Host, os, python, program and other texts, ``args``, ``started_at`` and ``git`` with its ``commit``."""
    found: dict[str, Any] = {field.name: value for field, value in record.ListFields() if isinstance(value, str)}
    if record.args:
        found["args"] = list(record.args)
    if record.git.commit:
        found["git"] = {"commit": record.git.commit}
    if record.HasField("started_at"):
        found["started_at"] = record.started_at.ToJsonString()
    return found


def _plain(items: Any) -> dict[str, Any]:
    """A message's items by name; the parts of a nested one are joined by dots."""
    names = [item.key or ".".join(item.nested_key) for item in items]
    # At once, which takes a quarter of the time.
    return dict(zip(names, json.loads(f"[{','.join(item.value_json for item in items)}]"), strict=True))


def _add(item: dict[str, Any], columns: dict[str, array[float]], row: int) -> None:
    """Appends one row of numbers; infinite ones, which wandb writes as text, are not known."""
    for name, value in item.items():
        if isinstance(value, str):
            if value not in ("NaN", "Infinity", "-Infinity"):
                continue
            value = math.nan
        if isinstance(value, int | float):
            column = columns.setdefault(name, array("d"))
            column.extend([math.nan] * (row - len(column)))
            column.append(value)


def _picture(item: dict[str, Any], logged: Logged) -> None:
    """Notes the picture of a row, if it has one and its file lies inside the run."""
    files = logged.path.parent / "files"
    for name in item:
        if name.endswith("._type") and item[name] == "image-file":
            picture = files / str(item.get(name.removesuffix("_type") + "path"))
            if picture.resolve().is_relative_to(files.resolve()) and picture.is_file():
                logged.pictures[int(item.get("_step", 0))] = picture
