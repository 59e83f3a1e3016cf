"""Where what is made from a run belongs, however the run is reached."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from xqmap.config import plugins

HOME = "from xqmap.runs import places; print(places.PRETRAINED, places.home('pretrained/landing'), sep='\\n')"


def test_nothing_lands_in_a_package_that_is_reached_through_a_link(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(plugins.CONF.parent)
    command = [sys.executable, "-c", HOME]
    here = os.environ | {"PYTHONPATH": str(tmp_path / "link")}
    done = subprocess.run(command, cwd=tmp_path, env=here, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    _, home = done.stdout.splitlines()
    assert home == "."
