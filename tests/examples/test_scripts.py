"""The examples that are one script each, run as their readers run them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def printed(script: str, cwd: Path) -> str:
    """What an example prints."""
    command = [sys.executable, str(ROOT / "examples" / script)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_cliff_world_is_solved_to_rounding_and_told_by_rdx_and_msx(tmp_path: Path) -> None:
    said = printed("cliff_world/cliff.py", tmp_path)
    found = re.search(r"differ by (\S+) at most", said)
    assert found is not None
    assert float(found[1]) < 1e-5
    gold, cliff, monster = said.split("why not step")[1:]
    assert "because treasure speaks for it (+5.90), though gold speaks against it (-4.00)" in gold
    assert "MSX+: treasure; MSX-: nothing" in gold
    assert "RDX: cliff +10.00, gold +0.00, monster +0.00, treasure +6.56\nMSX+: cliff;" in cliff
    assert "monster +10.00" in monster


@pytest.mark.sim
def test_deep_sea_treasure_is_learned_through_torchrl_and_explained(tmp_path: Path) -> None:
    pytest.importorskip("mo_gymnasium", reason="the extra 'examples' is not installed")
    said = printed("deep_sea_treasure/dive.py", tmp_path)
    rows = re.findall(r"(\S+): best moves in (\S+)% .* off by (\S+) and (\S+)", said)
    ours, hra = ([float(number) for number in row[1:]] for row in rows)
    assert [row[0] for row in rows] == ["X-QMap", "HRA"]
    assert ours[0] >= 98
    assert max(ours[1:]) < 0.3
    # Each of HRA's parts values a future of its own.
    assert max(hra[1:]) > 0.5
    assert "rather than the dive down (B), because treasure speaks for it" in said
