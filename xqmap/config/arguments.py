"""Settings whose value is free text (a question, an address, a path): typed as it is, whatever Hydra's grammar makes of
its signs, and printed so that it can be pasted.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from hydra.core.override_parser.types import Quote, QuotedString

from xqmap.errors import UserError

# Settings of the commands that name a file or directory.
PLACES = ("run", "runs", "decision", "out", "figures", "log", "questions", "resume", "images")
_TEXTS = ("question", "llm.base_url", "llm.model")
# Hydra's own, which may hold ${...}.
_DIRECTORIES = ("hydra.run.dir", "hydra.sweep.dir")
_ARGUMENT = re.compile(
    rf"(?P<plus>\+{{0,2}})(?P<name>{'|'.join(map(re.escape, (*PLACES, *_TEXTS, *_DIRECTORIES)))})=(?P<value>.*)",
    re.DOTALL,
)
_QUOTED = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*\"""", re.DOTALL)
# Bytes that file systems give a name.
_LONGEST_NAME = 255


def literal(arguments: Sequence[str]) -> list[str]:
    """Command-line arguments for Hydra, in which free text means itself.

    Left as they are: ``null``, what is in quotes already (unless a file is called so), and in a sweep lists of values.

    Raises:
        UserError: if a name in a path is longer than file systems allow.
    """
    sweep = "-m" in arguments or "--multirun" in arguments
    return [argument if sweep and "," in argument else _literal(argument) for argument in arguments]


def _literal(argument: str) -> str:
    found = _ARGUMENT.fullmatch(argument)
    if found is None or found["value"].lower() in ("", "null"):
        return argument
    name, value = found["name"], found["value"]
    if name not in _TEXTS:
        _check_length(name, value)
    if _QUOTED.fullmatch(value) and not (name in PLACES and Path(value).exists()):
        return argument
    if value == "???":
        # To OmegaConf, this is a value that is missing.
        value = "./???" if name in PLACES else "??? "
    return f"{found['plus']}{name}={_quoted(value if name in _DIRECTORIES else _without_interpolations(value))}"


def setting(name: str, value: object) -> str:
    """``name=value`` to be pasted into a shell, such that :func:`literal` gives the value back."""
    text = str(value)
    ambiguous = text.lower() == "null" or _QUOTED.fullmatch(text)
    return shlex.quote(f"{name}={_quoted(_without_interpolations(text)) if ambiguous else text}")


def command(name: str, **settings: object) -> str:
    """The command line ``python -m xqmap.NAME`` with settings, to be pasted into a shell."""
    return " ".join([f"python -m xqmap.{name}", *(setting(key, value) for key, value in settings.items())])


def _quoted(text: str) -> str:
    return QuotedString(text, Quote.single).with_quotes()


def _without_interpolations(text: str) -> str:
    """Text that OmegaConf resolves to ``text``."""
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", text)


def _check_length(name: str, path: str) -> None:
    if any(len(os.fsencode(part)) > _LONGEST_NAME for part in path.split("/") if "${" not in part):
        raise UserError(f"{name}: {too_long(path)}")


def too_long(path: str) -> str:
    """What is told of a path with a name that no file system takes."""
    longest = max(path.split("/"), key=lambda part: len(os.fsencode(part)))
    return (
        f"the name {longest[:40]}... has {len(os.fsencode(longest))} bytes, and a file system takes {_LONGEST_NAME}: "
        "give a shorter one"
    )
