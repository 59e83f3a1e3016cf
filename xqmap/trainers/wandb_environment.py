"""What the environment may say to wandb. A variable that is meant for another run (its id, name, directory, server
process) would give all runs that are started beside it one id, or lead them elsewhere.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Of all of a person's runs: labels, where wandb keeps its own things, and whether it reports its own errors.
_ALWAYS = ("NOTES", "TAGS", "RUN_GROUP", "JOB_TYPE", "CACHE_DIR", "CONFIG_DIR", "DATA_DIR", "ERROR_REPORTING")
# Who one is, and how the server is reached: only asked by what talks to one.
_ONLINE = (
    "API_KEY", "APP_URL", "BASE_URL", "CREDENTIALS_FILE", "ENTITY", "HTTP_TIMEOUT", "IDENTITY_TOKEN_FILE",
    "INIT_TIMEOUT", "INSECURE_DISABLE_SSL",
)  # fmt: skip
# What WANDB_MODE may hold, from the one that says most; wandb knows some by two names.
_MODES = {"online": 0, "run": 0, "shared": 0, "offline": 1, "dryrun": 1, "disabled": 2}


def mode(told: str) -> str:
    """``logger.mode``, or what ``WANDB_MODE`` says where that keeps more to itself: nothing is sent, or logged, that
    either of them forbids.
    """
    names = {0: "online", 1: "offline", 2: "disabled"}
    return names[max(_MODES[told], _MODES.get(os.environ.get("WANDB_MODE", ""), 0))]


@contextmanager
def own(directory: Path, mode: str) -> Iterator[None]:
    """Lets a run begin that belongs to ``directory``; afterwards the environment is as it was.

    Args:
        directory: of the run.
        mode: ``offline`` or ``online``.
    """
    before = {name: value for name, value in os.environ.items() if name.startswith("WANDB_")}
    speak = {f"WANDB_{name}" for name in (*_ALWAYS, *(_ONLINE if mode == "online" else ()))}
    ours = {"WANDB_ERROR_REPORTING": "false", "WANDB_DATA_DIR": str(directory / "wandb")}
    try:
        _replace(ours | {name: value for name, value in before.items() if name in speak})
        os.environ["WANDB_DIR"] = str(directory)
        yield
    finally:
        # wandb and torchrl leave variables of their own.
        _replace(before)


def _replace(variables: dict[str, str]) -> None:
    """Makes these all that the environment says to wandb."""
    for name in [name for name in os.environ if name.startswith("WANDB_")]:
        del os.environ[name]
    os.environ.update(variables)
