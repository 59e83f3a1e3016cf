"""matplotlib is there after ``import xqmap``, with its user's settings where it can read them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import os
import xqmap
import matplotlib, matplotlib.cbook, matplotlib.style
from matplotlib.figure import Figure
figure = Figure()
figure.subplots().set_title("a")
figure.savefig("a.png")
print(matplotlib.rcParams["lines.linewidth"], os.getcwd(), os.environ.get("MPLBACKEND"), sep="|")
"""


@pytest.mark.parametrize(
    ("settings", "backend", "width"),
    [
        (b"lines.linewidth: 7\n", "svg", 7),
        (b"lines.linewidth: 7\n\xff", "svg", 1.5),
        (b"lines.linewidth: 7\nbackend: nonsense", "svg", 7),
        (b"lines.linewidth: 7\n", "nonsense", 1.5),
    ],
)
def test_settings_hold_where_they_can_be_read(settings: bytes, backend: str, width: float, tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(settings)
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        cwd=tmp_path,
        env=os.environ | {"MPLBACKEND": backend},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == f"{width}|{tmp_path}|{backend}".replace("7|", "7.0|")
    assert (tmp_path / "a.png").stat().st_size > 1000
