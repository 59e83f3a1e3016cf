"""Reads a wandb run's file through wandb's own public reader, ``wandb leet inspect --json``: one JSON record per
line.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

# Only these records are parsed; most of a file is running summaries, which repeat the history.
_WANTED = tuple(f'"type":"{kind}"'.encode() for kind in ("run", "environment", "history", "exit"))


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
        trouble: what the reader says against the file; empty if nothing.
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
    command = [sys.executable, "-m", "wandb", "leet", "inspect", "--json", str(path)]
    quiet = os.environ | {"WANDB_ERROR_REPORTING": "false"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=quiet) as reader:
        assert reader.stdout is not None and reader.stderr is not None
        for line in reader.stdout:
            if not any(kind in line[:60] for kind in _WANTED):
                continue
            record = json.loads(line)
            content = record.get(record["type"], {})
            if record["type"] == "history":
                _add(content.get("item", {}), columns, rows)
                _picture(content.get("item", {}), logged)
                rows += 1
            elif record["type"] == "run":
                logged.config |= content.get("config", {}).get("update", {})
            elif record["type"] == "environment":
                logged.environment |= content
            else:
                logged.exit_code = int(content.get("exit_code", 0))
        logged.trouble = reader.stderr.read().decode(errors="replace").strip().removeprefix("wandb leet inspect: ")
    logged.columns = {name: np.array([*values, *[math.nan] * (rows - len(values))]) for name, values in columns.items()}
    return logged


def _add(item: dict[str, Any], columns: dict[str, array[float]], row: int) -> None:
    """Appends one row of numbers; the reader gives NaN and infinity as text."""
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
