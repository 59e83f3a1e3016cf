"""``.ci/setup`` with interpreters that only pretend: what it takes, what it says in one line, and that it goes on."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TOOLS = ["awk", "bash", "cat", "cksum", "df", "dirname", "grep", "mktemp", "rm", "sed", "seq", "tail", "touch"]

# An interpreter: its -m venv copies it, its -m pip brings a uv, and each downloading command is written down.
PYTHON = """#!/bin/bash
case "$*" in
    *version_info*) echo "{version}" ;;
    *ensurepip*) exit {bare} ;;
    --version) echo "Python {version}.0" ;;
    "-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python" ;;
    *" install "*)
        echo pip >>"$CALLS"
        if [ -n "${{NO_NETWORK:-}}" ]; then
            echo "WARNING: broken by 'X: [Errno -2] Name or service not known')': /simple/uv/"
            echo "ERROR: No matching distribution found for uv"
            exit 1
        fi
        cp "$UV" "${{0%/*}}/uv" ;;
esac
"""
UV = """#!/bin/bash
case "$*" in
    "cache dir") echo "$PWD" ;;
    *--dry-run*)
        if [ -n "${OFFLINE:-}" ]; then echo "error: failed"; echo "  cause: dns error"; exit 2; fi
        echo "Would install 9 packages"; echo "$PLAN" ;;
    "pip install"*)
        echo install >>"$CALLS"
        if [ -n "${KILLED:-}" ]; then kill -9 $PPID; fi ;;
esac
"""


@dataclass
class Machine:
    """A checkout and a PATH with nothing but what ``.ci/setup`` itself calls, and what :meth:`add` puts there."""

    root: Path
    env: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, text: str, folder: str = "bin") -> Path:
        (self.root / folder).mkdir(exist_ok=True)
        path = self.root / folder / name
        path.write_text(text)
        path.chmod(0o755)
        return path

    def python(self, name: str, version: str, bare: bool = False, folder: str = "bin") -> Path:
        return self.add(name, PYTHON.format(version=version, bare=int(bare)), folder)

    def setup(self, **env: str) -> subprocess.CompletedProcess[str]:
        path = ":".join(f"{self.root}/{folder}" for folder in ("bin", "later", "tools"))
        command = ["bash", ".ci/setup", ".venv"]
        variables = {"PATH": path, "PLAN": "", **self.env, **env}
        return subprocess.run(command, cwd=self.root / "checkout", env=variables, capture_output=True, text=True)

    def refused(self, **env: str) -> str:
        """The one line with which a set-up ends that leaves nothing behind."""
        done = self.setup(**env)
        lines = done.stderr.splitlines()
        assert done.returncode == 1 and len(lines) == 1 and lines[0].startswith("xqmap: "), done.stderr
        assert not self.venv.exists() and "install" not in self.calls
        return lines[0]

    @property
    def venv(self) -> Path:
        return self.root / "checkout" / ".venv"

    @property
    def chosen(self) -> str:
        return subprocess.run([self.venv / "bin/python", "--version"], capture_output=True, text=True).stdout.strip()

    @property
    def calls(self) -> list[str]:
        return Path(self.env["CALLS"]).read_text().split()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    checkout = tmp_path / "checkout"
    shutil.copytree(ROOT / ".ci", checkout / ".ci")
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, checkout)
    (tmp_path / "tools").mkdir()
    for name in [*TOOLS, "mkdir", "cp"]:
        (tmp_path / "tools" / name).symlink_to(str(shutil.which(name)))
    (tmp_path / "calls").touch()
    machine = Machine(tmp_path, {"CALLS": f"{tmp_path}/calls", "UV": f"{tmp_path}/uv/uv"})
    machine.add("uv", UV, "uv")
    machine.add("df", "#!/bin/bash\necho heading\necho disk 0 0 $((${FREE:-99} * 1048576)) 0% /\n")
    return machine


@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_python3_is_taken_where_it_fits_and_the_second_time_is_quick(machine: Machine, version: str) -> None:
    machine.python("python3", version)
    assert machine.setup().returncode == 0
    assert machine.chosen == f"Python {version}.0" and machine.calls == ["pip", "install"]
    assert machine.setup().returncode == 0
    assert machine.calls == ["pip", "install"]


@pytest.mark.parametrize("unfit", ["3.10", "3.14", "2.7"])
def test_another_interpreter_on_the_path_is_taken(machine: Machine, unfit: str) -> None:
    machine.python("python3", unfit)
    machine.add("python3.13", "#!/bin/bash\necho 'pyenv: python3.13: command not found' >&2; exit 127\n")
    machine.python("python3.12", "3.12")
    assert machine.setup().returncode == 0 and machine.chosen == "Python 3.12.0"
    machine.python("python3.13", "3.13", folder="later")
    assert machine.setup(PYTHON="python3.13").returncode == 0 and machine.chosen == "Python 3.13.0"


@pytest.mark.parametrize("unfit", ["3.10", "3.14"])
def test_no_interpreter_that_fits(machine: Machine, unfit: str) -> None:
    machine.python("python3", unfit)
    line = machine.refused()
    assert f"needs Python 3.11 to 3.13, and the PATH has none ({machine.root}/bin/python3 is Python {unfit})" in line
    assert "PYTHON=" in line
    machine.python("python3.12", "3.12")
    assert f"is Python {unfit}" in machine.refused(PYTHON="python3")
    assert "PYTHON=python4: it does not run" in machine.refused(PYTHON="python4")


def test_no_venv_module(machine: Machine) -> None:
    machine.python("python3", "3.13", bare=True)
    assert "apt-get install python3.13-venv" in machine.refused()
    copies = 'mkdir -p "$3/bin"; cp "$2" "$3/bin/python"'
    machine.add("virtualenv", f'#!/bin/bash\n{copies}; echo "$*" >{machine.root}/asked\n')
    assert machine.setup().returncode == 0 and machine.chosen == "Python 3.13.0"
    assert (machine.root / "asked").read_text().split() == ["--python", f"{machine.root}/bin/python3", ".venv"]


def test_one_with_a_venv_module_goes_before_one_without(machine: Machine) -> None:
    machine.python("python3", "3.13", bare=True)
    machine.python("python3.11", "3.11")
    assert machine.setup().returncode == 0 and machine.chosen == "Python 3.11.0"


def test_too_little_disk(machine: Machine) -> None:
    machine.python("python3", "3.13")
    assert "needs 3 GiB of disk" in machine.refused(FREE="2") and machine.calls == []
    assert re.search(r"needs 7 GiB of disk in .* CUDA build", machine.refused(FREE="5", PLAN=" + nvidia-cublas==13.1"))
    assert machine.setup(FREE="5").returncode == 0


def test_no_network(machine: Machine) -> None:
    machine.python("python3", "3.13")
    line = machine.refused(NO_NETWORK="yes")
    assert "no package can be downloaded ([Errno -2] Name or service not known)" in line and "pip config list" in line
    assert "the packages cannot be found (cause: dns error)" in machine.refused(OFFLINE="yes")


def test_an_interrupted_setup_goes_on_with_the_same_command(machine: Machine) -> None:
    machine.python("python3", "3.13")
    assert machine.setup(KILLED="yes").returncode != 0
    (machine.venv / "half-written").touch()
    assert machine.setup().returncode == 0
    assert not (machine.venv / "half-written").exists() and machine.chosen == "Python 3.13.0"


def test_new_versions_are_installed_into_the_environment_that_is_there(machine: Machine) -> None:
    machine.python("python3", "3.13")
    assert machine.setup().returncode == 0
    (machine.venv / "kept").touch()
    with (machine.root / "checkout/constraints.txt").open("a") as file:
        file.write("# newer\n")
    assert machine.setup().returncode == 0
    assert machine.calls == ["pip", "install", "install"] and (machine.venv / "kept").exists()


def test_what_pip_was_told_is_handed_on() -> None:
    translated = runpy.run_path(str(ROOT / ".ci/pip_settings.py"))["translated"]
    listing = [
        ":env:.find-links='/a /b'",
        ":env:.default-timeout='60'",
        "global.find-links='/c'",
        "global.extra-index-url='\\nfile:///d\\nfile:///e'",
        "global.proxy='p:1'",
        "install.proxy='p:2'",
        "list.format='columns'",
    ]
    assert translated("\n".join(listing)) == {
        "UV_FIND_LINKS": "/a,/b",
        "UV_HTTP_TIMEOUT": "60",
        "UV_INDEX": "file:///d file:///e",
        "UV_INDEX_STRATEGY": "unsafe-best-match",
        "HTTP_PROXY": "p:2",
        "HTTPS_PROXY": "p:2",
    }


def test_only_what_is_set_here_decides(tmp_path: Path) -> None:
    environment = {**os.environ, "PIP_FIND_LINKS": str(tmp_path), "UV_FIND_LINKS": "/mine"}
    command = [sys.executable, str(ROOT / ".ci/pip_settings.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert "UV_FIND_LINKS" not in done.stdout
