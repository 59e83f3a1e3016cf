"""Commands in processes of their own, as a person starts them."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
from functools import cache
from multiprocessing import forkserver
from pathlib import Path

# Imported once, without threads, in the process that commands are forked from: half of a short command is imports.
_IMPORTED = (
    "matplotlib.pyplot",
    "mani_skill.envs",
    "xqmap.config.cli",
    "xqmap.evaluation.sweeps",
    "xqmap.explanations.dialogue.scoring",
    "xqmap.explanations.views.page",
    "xqmap.reports.page",
    "xqmap.runs.run",
    "xqmap.trainers.training",
    "xqmap_tasks.grasping",
    "xqmap_tasks.landing",
)


def start(module: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """``python -m xqmap.MODULE`` by a new interpreter: where it matters how a command begins."""
    command = [sys.executable, "-m", f"xqmap.{module}", *arguments]
    # Meant for another program of Hydra's: here its own lines never come.
    variables = _clean() | {"HYDRA_FULL_ERROR": "0"}
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600, env=variables)


def call(module: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The same in a process that is forked from one where the imports are done."""
    _have_imported()
    context = multiprocessing.get_context("forkserver")
    with tempfile.TemporaryDirectory() as folder:
        out, error = (Path(folder) / name for name in ("out", "error"))
        process = context.Process(target=_run, args=(module, arguments, str(cwd), _clean(), str(out), str(error)))
        process.start()
        process.join(600)
        if process.is_alive():
            process.kill()
            process.join()
        # What a command that was never begun says is in pytest's own capture.
        told = [path.read_text(errors="replace") if path.exists() else "" for path in (out, error)]
    return subprocess.CompletedProcess([module, *arguments], process.exitcode or 0, *told)


@cache
def _have_imported() -> None:
    # What another test began imports less, and would not change any more.
    forkserver._forkserver._stop()  # type: ignore[attr-defined]
    forkserver.set_forkserver_preload([*_IMPORTED, __name__])


def _clean() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith(("OPENAI", "HYDRA"))}


def _run(module: str, arguments: tuple[str, ...], cwd: str, variables: dict[str, str], out: str, error: str) -> None:
    for number, path in ((0, os.devnull), (1, out), (2, error)):
        handle = os.open(path, os.O_RDONLY if number == 0 else os.O_WRONLY | os.O_CREAT, 0o600)
        os.dup2(handle, number)
        os.close(handle)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 (multiprocessing put another there)
    # What was set while importing stays.
    os.environ.update(variables)
    os.chdir(cwd)
    sys.argv = [f"xqmap.{module}", *arguments]
    # As python -m has it: the command's own module is __main__, and nobody has imported it before.
    sys.modules.pop(f"xqmap.{module}", None)
    runpy.run_module(f"xqmap.{module}", run_name="__main__", alter_sys=True)
