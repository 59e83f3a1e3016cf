"""What a command says of an error, and what it shows where it is asked to."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from xqmap import doctor
from xqmap.config import cli
from xqmap.envs.guard import guarded


@cli.main("doctor")
def broken(cfg: Any) -> None:
    with guarded("scene 7", None):
        a_world_of_mine()


def a_world_of_mine() -> None:
    raise AttributeError("no robot")


def test_an_error_of_a_world_is_one_line_that_names_how_to_see_its_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["doctor"])
    monkeypatch.delenv("XQMAP_TRACEBACK", raising=False)
    line = (
        r"^error: the simulator failed in scene 7 \(AttributeError: no robot\); XQMAP_TRACEBACK=1 shows its traceback$"
    )
    with pytest.raises(SystemExit, match=line):
        broken()
    assert "a_world_of_mine" not in capsys.readouterr().err
    monkeypatch.setenv("XQMAP_TRACEBACK", "1")
    with pytest.raises(SystemExit, match=line):
        broken()
    assert "in a_world_of_mine" in capsys.readouterr().err


def test_a_checkout_is_told_to_set_up() -> None:
    assert "make setup" in doctor.FIX_VULKAN
