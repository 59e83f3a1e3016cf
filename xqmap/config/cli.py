"""What every command shares: Hydra around it, one clear line for a mistake, and a non-zero exit."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xqmap import launch
from xqmap.config import arguments, plugins, schema
from xqmap.errors import TRACEBACK, Stopped, UserError
from xqmap.terminal import endure, one_line, say

# Hydra's own short message would be followed by advice to set this, whatever it is set to; we print one line ourselves.
os.environ["HYDRA_FULL_ERROR"] = "1"


def main(config_name: str) -> Callable[[Callable[[DictConfig], Any]], Callable[[], None]]:
    """Turns ``command(cfg)`` into a program configured by ``conf/<config_name>.yaml`` and ``key=value`` arguments.

    Exit status: 0 when it did what was asked, 1 on a mistake the person can mend (told in one line), 130 on Ctrl-C, 143
    on SIGTERM, 129 on SIGHUP (the terminal is gone); a print that nobody can read changes none of that. Of a sweep's
    jobs (``-m``) one that fails does not keep the others from running; Ctrl-C ends the sweep.
    """

    def wrap(command: Callable[[DictConfig], Any]) -> Callable[[], None]:
        def program() -> None:
            launch.imported()
            endure()
            schema.register()
            logging.getLogger("torchrl").setLevel(logging.WARNING)
            failed: list[Exception] = []
            composed = False

            def guarded(cfg: DictConfig) -> Any:
                nonlocal composed
                composed = True
                # A parallel launcher's process has done neither.
                endure()
                schema.register()
                try:
                    _read_places(cfg)
                    return command(cfg)
                except BaseException as error:
                    _forget_empty_run()
                    # One job's failure is Hydra's to keep until the others have run; of a single run it would add lines
                    # of its own.
                    if not isinstance(error, Exception) or HydraConfig.get().mode == RunMode.MULTIRUN:
                        raise
                    failed.append(error)

            for number in launch.stopping():
                signal.signal(number, _terminate)
            try:
                sys.argv = [sys.argv[0], *arguments.literal(sys.argv[1:])]
                hydra.main(version_base=None, config_path=str(plugins.CONF), config_name=config_name)(guarded)()
                for error in failed:
                    raise error
            except Stopped as error:
                sys.exit(128 + error.number)
            except KeyboardInterrupt:
                say("stopped", to=sys.stderr)
                sys.exit(130)
            except Exception as error:
                # Before the command began, whatever went wrong is a mistake in its arguments, of whichever type Hydra
                # makes it.
                if not (line := told(error) if composed else told(error) or mistake(error)):
                    raise
                if os.environ.get(TRACEBACK):
                    say("".join(traceback.format_exception(error)), to=sys.stderr)
                sys.exit(one_line(f"error: {line}"))

        return program

    return wrap


def told(error: Exception) -> str:
    """What a person is told of ``error``; empty for one that is our own mistake and needs its traceback."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return mistake(error)
    if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
        return f"{arguments.too_long(str(error.filename))} (of a sweep's jobs: hydra.sweep.subdir='${{hydra.job.num}}')"
    if isinstance(error, OSError):
        place = f"{error.strerror or error}: {error.filename or 'a file of this run'}"
        return f"{place} (another directory: hydra.run.dir=DIR or out=PLACE)"
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and "allocate memory" in str(error)):
        return "not enough memory: lower replay.capacity, trainer.batch_size or qnet.width"
    return ""


def _terminate(number: int, frame: FrameType | None) -> None:
    say("stopped", to=sys.stderr)
    raise Stopped(number)


def _read_places(cfg: DictConfig) -> None:
    """Makes a text of every file or directory that was given: one named 7 would be a number."""
    for name in arguments.PLACES:
        value = cfg.get(name) if name in cfg and not OmegaConf.is_missing(cfg, name) else None
        if OmegaConf.is_config(value) or (isinstance(value, str) and "\0" in value):
            raise UserError(f"{name}={value} must be one file or directory")
        if isinstance(value, bool | int | float):
            cfg[name] = str(value)


def required(cfg: DictConfig, name: str, example: str) -> Any:
    """The value of the setting ``name``, or a clear line that asks for it with an ``example``."""
    if OmegaConf.is_missing(cfg, name):
        raise UserError(f"{name} has no value: give {example}")
    return cfg[name]


def decisions(cfg: DictConfig) -> int | None:
    """How many decisions of the scene ``scene_seed`` the setting ``steps`` asks for; None for all of the episode.

    Raises:
        UserError: if one of the two settings is none.
    """
    if cfg.steps != "all" and not (isinstance(cfg.steps, int) and cfg.steps >= 1):
        raise UserError(f"steps={cfg.steps} is neither a number of decisions from 1 on nor 'all'")
    if not isinstance(cfg.scene_seed, int) or not 0 <= cfg.scene_seed < 2**32:
        raise UserError(f"scene_seed={cfg.scene_seed} must be a whole number of at least 0 and below 2**32")
    return None if cfg.steps == "all" else int(cfg.steps)


def resume_in_place(arguments: list[str]) -> None:
    """Lets ``resume=DIR`` work inside DIR: Hydra opens no new run directory and keeps the old one's settings.

    Raises:
        SystemExit: if other settings stand beside ``resume``; a run goes on as it was started.
    """
    given = [argument.lstrip("+") for argument in arguments[1:]]
    resumed = next((argument.removeprefix("resume=") for argument in given if argument.startswith("resume=")), None)
    if resumed and resumed != "null":
        if len(arguments) > 2:
            sys.exit("error: resume=DIR goes on with the settings the run was started with: give no other setting")
        arguments += [
            "hydra.run.dir=.",
            "hydra.output_subdir=null",
            "hydra/job_logging=none",
            "hydra/hydra_logging=none",
        ]


def _forget_empty_run() -> None:
    """Takes back the run directory that Hydra made, if nothing got into it."""
    directory = Path(HydraConfig.get().runtime.output_dir)
    if directory != Path.cwd():
        with contextlib.suppress(OSError):
            directory.rmdir()


def mistake(error: Exception) -> str:
    """Hydra's message without its stack of causes and its advice."""
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    lines = [line.strip() for line in str(cause if str(cause) else error).splitlines() if line.strip()]
    if "Config search path:" in lines:
        lines = lines[: lines.index("Config search path:")]
    kept = [line for line in lines if not line.startswith(("object_type", "reference_type", "See https://"))]
    key = next((line.removeprefix("full_key:").strip() for line in kept if line.startswith("full_key:")), "")
    if any("Missing mandatory value: task" in line for line in kept):
        return "no task: add +task=NAME, one of conf/task (+task=landing)"
    text = " ".join(line for line in kept if not line.startswith("full_key:"))
    return (
        f"{key}: {text}"
        if key and key not in text
        else text or f"these arguments cannot be read ({type(error).__name__})"
    )
