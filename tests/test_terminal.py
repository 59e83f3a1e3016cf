"""What is said may be lost or spelled otherwise; what was made is there all the same."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.evaluation.test_results import write_run
from tests.test_commands import decision_file
from xqmap import terminal
from xqmap.errors import brief

# How a command is started, and the variables it has.
WAYS = {
    "ascii": ("{report} 2>/dev/full", {"PYTHONIOENCODING": "ascii"}),
    "latin": (
        "{report}",
        {"PYTHONIOENCODING": "latin-1", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ),
    "full": ("{report} >/dev/full", {}),
    "unread": ("{report} | true", {}),
    "closed": ("{report} <&- >&- 2>&-", {}),
    "nobody asks": ("{chat} <&- 2>&-", {}),
    "odd questions": ("printf 'why \\351\\nexit\\n' | {chat} >&-", {"PYTHONIOENCODING": "ascii"}),
}


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str, str, Path]]:
    """What became of every way to start a command: exit status, standard output and error, and its directory."""
    started = {}
    for name, (line, variables) in WAYS.items():
        folder = tmp_path_factory.mktemp("way")
        write_run(folder / "runs", "a", 9)
        (folder / "runs" / "b\x1b[2J\x9b\nerror").mkdir()
        (folder / "runs" / "b\x1b[2J\x9b\nerror" / "evaluation.json").write_text("not one")
        decision_file(folder)
        python = f"{sys.executable} -m xqmap"
        line = line.format(
            python=python,
            report=f"{python}.report runs=runs out=report.csv format=csv",
            chat=f"{python}.chat decision=decision.json out=.",
        )
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
        # The status of the command, not of what stands behind its pipe.
        command = ["bash", "-o", "pipefail", "-c", line]
        started[name] = subprocess.Popen(command, cwd=folder, env=os.environ | variables, **pipes), folder  # type: ignore[call-overload]
    found = {}
    for name, (process, folder) in started.items():
        out, error = process.communicate(timeout=600)
        found[name] = process.returncode, out.decode("latin-1"), error.decode("latin-1"), folder
    return found


@pytest.mark.parametrize("way", WAYS)
def test_a_terminal_that_takes_nothing_costs_no_result(way: str, ended: dict[str, tuple[int, str, str, Path]]) -> None:
    status, out, error, folder = ended[way]
    assert status == 0, error
    assert "Traceback" not in out + error
    if "{report}" in WAYS[way][0]:
        assert "landing,,xqmap" in (folder / "report.csv").read_text()
    if way == "odd questions":
        assert (folder / "dialogue.json").exists()


def test_signs_that_an_encoding_does_not_know_are_spelled(ended: dict[str, tuple[int, str, str, Path]]) -> None:
    assert "59.6 - 98.2 %" in ended["ascii"][1]
    assert "+- over runs" in ended["ascii"][1] and ended["ascii"][1].isascii()
    assert "± over runs" in ended["latin"][1]


def test_a_full_disk_is_told_once_and_a_reader_that_left_is_not(
    ended: dict[str, tuple[int, str, str, Path]],
) -> None:
    assert ended["full"][2].count("what is printed is lost (No space left on device)") == 1
    assert "lost" not in ended["unread"][2]


def test_a_strangers_name_moves_no_cursor_and_makes_no_line(ended: dict[str, tuple[int, str, str, Path]]) -> None:
    lines = [line for line in ended["ascii"][1].splitlines() if "left out" in line]
    assert len(lines) == 1 and "error/evaluation.json" in lines[0]
    assert lines[0].isprintable()


def test_control_characters_are_not_said() -> None:
    told = io.StringIO()
    terminal.say("a\x1b[31mred\x1b[0m\x07\rb\u202e", "second\nline", end="!", to=told)
    assert told.getvalue() == "ared  b  second\nline!"
    assert terminal.one_line(" a\n\x1b]0;title\x07\t b\u2028") == "a ]0;title b"
    assert brief(ValueError("one\x1b[2J\ntwo\x00")) == "one [2J two"


def test_nothing_stands_in_for_what_stands_in(capsys: pytest.CaptureFixture[str]) -> None:
    before = sys.stdout, sys.stderr
    terminal.endure()
    assert (sys.stdout, sys.stderr) == before
    assert "−–é…漢".encode("ascii", "spelled") == b"--e...?"


_NEIGHBOUR_GONE = """
import socket, sys, time
from multiprocessing import resource_sharer
from xqmap import terminal
if sys.argv[1] == "quiet":
    terminal.pass_over_the_gone()
served = resource_sharer.DupFd(0)
address, _ = served._id
neighbour = socket.socket(socket.AF_UNIX)
neighbour.connect(address)
neighbour.close()
time.sleep(1)
"""


@pytest.mark.parametrize(("how", "told"), [("quiet", False), ("as it comes", True)])
def test_a_neighbour_that_ends_while_it_fetches_something_is_no_news(how: str, told: bool) -> None:
    done = subprocess.run([sys.executable, "-c", _NEIGHBOUR_GONE, how], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert ("Traceback" in done.stderr) is told, done.stderr
