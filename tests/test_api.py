"""``import xqmap`` in a notebook: the lines of its own description, and what is refused."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import xqmap
from xqmap import api
from xqmap.errors import UserError
from xqmap.runs.run import Run


@pytest.mark.sim
def test_the_ten_lines_do_what_they_say(tmp_path: Path) -> None:
    lines = textwrap.dedent(str(api.__doc__).split("\n\n", 1)[1])
    assert len(lines.split("\n\n", 1)[1].strip().splitlines()) <= 10
    done = subprocess.run([sys.executable, "-c", lines], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert re.search(r"because", done.stdout)
    assert re.search(r"\{'flatness': [\d.]+, 'color': [\d.]+\}", done.stdout)
    assert (tmp_path / "why.png").stat().st_size > 10_000


@pytest.mark.sim
def test_a_world_by_name_and_an_agent_that_learns_in_it(tmp_path: Path) -> None:
    small = ["trainer.frames=8", "trainer.warmup_frames=4", "logger.mode=disabled"]
    agent = xqmap.learn("toy", *small, out=tmp_path / "mine")
    assert isinstance(agent, Run)
    assert agent.decisions == 8
    env = xqmap.make_env("toy", scene=5)
    state = env.reset()
    decision = xqmap.decide(agent, env, state, candidates="object")
    assert decision.scene_seed == 5
    after = xqmap.play(env, state, decision)
    assert float(after["reward"]) == pytest.approx(sum(xqmap.rewards(env, after).values()))
    # A cell of one's own, in the scene as it is now.
    assert bool(xqmap.play(env, after, 0)["done"])
    with pytest.raises(UserError, match="already holds a run"):
        xqmap.learn("toy", *small, out=tmp_path / "mine")


def test_what_is_not_there_is_said() -> None:
    with pytest.raises(UserError, match="perception='eyes' is not installed"):
        xqmap.decide(None, None, None, perception="eyes")  # type: ignore[arg-type]
    with pytest.raises(AttributeError, match="nothing"):
        _ = xqmap.nothing


def test_the_first_import_brings_no_network() -> None:
    program = "import sys, xqmap; assert not {'torch', 'torchrl', 'wandb', 'hydra'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
