"""``import xqmap`` in a notebook: the lines of its own description, and what is refused."""

from __future__ import annotations

import importlib
import subprocess
import sys
import textwrap
from html import unescape
from pathlib import Path

import pytest

import xqmap
from xqmap import api
from xqmap.errors import UserError
from xqmap.explanations import Candidate, Decision
from xqmap.runs.run import Run

TEN_LINES = textwrap.dedent(str(api.__doc__).split("\n\n", 1)[1])
# What a notebook does with the values of lines, and what the lines are to have made.
_LOOKED_AT = """
from pathlib import Path
assert decision.why("B").startswith("I chose to land on"), decision.why("B")
assert "toss-up" in decision.ask("how sure are you?") or "clear" in decision.ask("how sure are you?")
assert set(env.rewards(state)) == {"flatness", "color"}
Path("page.html").write_text(decision._repr_html_())
Path("page.png").write_bytes(decision._repr_png_())
Path("shown.png").write_bytes(decision.show()._repr_png_())
"""


@pytest.mark.sim
def test_the_ten_lines_do_what_they_say(tmp_path: Path) -> None:
    assert len([line for line in TEN_LINES.splitlines() if line.strip()]) <= 10
    # As printed; a training of 200 decisions takes minutes.
    lines = TEN_LINES.replace("frames=200", 'frames=8, warmup_frames=4, mode="disabled"')
    assert lines != TEN_LINES
    program = [sys.executable, "-c", lines + _LOOKED_AT]
    done = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (trained,) = (tmp_path / "runs").iterdir()
    assert trained.name.startswith("landing-xqmap-seed0-")
    assert (trained / "checkpoint" / "policy.safetensors").exists()
    for name in ("page.png", "shown.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    shown = (tmp_path / "page.html").read_text()
    assert len(shown) < 300_000
    assert "how sure are you?" in unescape(shown)
    assert "default-src 'none'" in unescape(shown)


@pytest.mark.sim
def test_a_world_by_name_and_an_agent_that_is_trained_in_it(tmp_path: Path) -> None:
    small = {"frames": 8, "warmup_frames": 4, "mode": "disabled"}
    agent = xqmap.train("toy", **small, out=tmp_path / "mine")
    assert isinstance(agent, Run)
    assert (agent.decisions, agent.directory) == (8, tmp_path / "mine")
    assert repr(agent) == "<agent of toy: xqmap on left, right, 8 decisions>"
    env = xqmap.make_env("toy", scene=5)
    state = env.reset()
    decision = agent.decide(state, env, candidates="object")
    assert decision.scene_seed == 5
    after = env.play(state, decision)
    assert float(after["reward"]) == pytest.approx(sum(env.rewards(after).values()))
    # A cell of one's own, in the scene as it is now.
    assert bool(env.play(after, 0)["done"])
    with pytest.raises(UserError, match="already holds a run: choose another out"):
        xqmap.train("toy", **small, out=tmp_path / "mine")
    with pytest.raises(UserError, match="perception='eyes' is not installed"):
        agent.decide(state, env, perception="eyes")
    with pytest.raises(UserError, match="neither pixel nor object"):
        agent.decide(state, env, candidates="thing")
    with pytest.raises(UserError, match="chose no cell"):
        env.play(state, Decision("toy", ("left",), [Candidate("Selected", "bay", {"left": 1.0})]))


def test_settings_by_keyword_are_those_of_the_command_line() -> None:
    changes = ["trainer.frames=100", "task.weights.color=2", "qnet.plane_windows=[3,5]", "threads=null", "method=hra"]
    told = xqmap.settings(
        "grasping", "task.weights.color=2", frames=100, plane_windows=[3, 5], threads=None, method="hra"
    )
    assert told == xqmap.settings("grasping", *changes)
    assert (told.trainer.frames, told.method.weights) == (100, [1.0, 2.0])


def test_a_setting_that_is_unknown_or_ambiguous_is_said() -> None:
    with pytest.raises(UserError, match="frame is no setting"):
        xqmap.settings("landing", frame=3)
    with pytest.raises(UserError, match=r"raised_height is both qnet.raised_height and exploration.raised_height"):
        xqmap.settings("landing", raised_height=0.1)
    with pytest.raises(UserError, match=r"trainer.frames=0 is out of range"):
        xqmap.settings("landing", frames=0)
    with pytest.raises(AttributeError, match="nothing"):
        _ = xqmap.nothing


def test_train_is_a_function_also_after_the_command_was_imported() -> None:
    importlib.import_module("xqmap.train")
    with pytest.raises(UserError, match="frame is no setting"):
        xqmap.train(task="landing", frame=3)


def test_the_first_import_brings_no_network() -> None:
    program = "import sys, xqmap; assert not {'torch', 'torchrl', 'wandb', 'hydra'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
