"""Where settings lie: in this package's ``conf``, and in that of every installed package that offers a world or a
perception. One lookup for all of them, and the only source of names of code that is run.

A package offers a world by an entry point of the group ``xqmap.tasks`` (its name → the package whose folder holds
``conf/task/<name>.yaml``), and what names objects by one of the group ``xqmap.perception`` (its name → a class
``package.module:Class``, or a package whose folder holds ``conf/explain/perception/<name>.yaml``).
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import re
from collections.abc import Iterator
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.plugins.search_path_plugin import SearchPathPlugin

from xqmap.config import plain
from xqmap.errors import UserError

_PACKAGE = Path(__file__).parents[1]
# An installed package carries its settings inside, the repository beside the package.
CONF = next(folder for folder in (_PACKAGE / "conf", _PACKAGE.parent / "conf") if folder.is_dir())
TASKS, PERCEPTION = "xqmap.tasks", "xqmap.perception"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


def is_name(text: str) -> bool:
    """Whether a text can name a task, a sheet or a method: one that leads to no other folder and prints as it is."""
    return _NAME.fullmatch(text) is not None


@cache
def offered() -> dict[tuple[str, str], Path]:
    """The ``conf`` folders of the installed packages by (group, name) of their entry points, in a fixed order.

    Raises:
        UserError: if two packages offer the same name.
    """
    found: dict[tuple[str, str], Path] = {}
    values: dict[tuple[str, str], str] = {}
    for point in sorted(_points(), key=lambda point: (point.group, point.name, point.value)):
        key = point.group, point.name
        if values.setdefault(key, point.value) != point.value:
            raise UserError(
                f"two installed packages offer {point.name!r} as {point.group}, {values[key]} and {point.value}: "
                "uninstall one"
            )
        if folder := _folder(point.value):
            found[key] = folder
    return found


@cache
def folders() -> tuple[Path, ...]:
    """All folders of settings, our own first: it cannot be overruled."""
    return tuple(dict.fromkeys((CONF, *offered().values())))


def find(*parts: str) -> Path | None:
    """The file at ``parts`` in the first folder that has it; None where a part is no plain name, or none has it."""
    if not all(map(is_name, parts)):
        return None
    return next((path for folder in folders() if (path := folder.joinpath(*parts)).is_file()), None)


def stems(*parts: str) -> list[str]:
    """The names of the yaml files in the directory at ``parts`` of all folders."""
    if not all(map(is_name, parts)):
        return []
    return sorted({path.stem for folder in folders() for path in folder.joinpath(*parts).glob("*.yaml")})


@cache
def worlds() -> dict[str, str]:
    """The class of every installed world, ``{task.name: "package.module.Class"}``."""
    found = {}
    for stem in stems("task"):
        path = find("task", f"{stem}.yaml")
        match _read(path) if path else None:
            case {"task": {"name": str(name), "env": {"_target_": str(target)}}}:
                found[name] = target
    return found


@cache
def perceptions() -> frozenset[str]:
    """The classes of all installed perceptions."""
    paths = [find("explain", "perception", f"{stem}.yaml") for stem in stems("explain", "perception")]
    named = {_read(path).get("_target_") for path in paths if path}
    return frozenset(name for name in named if isinstance(name, str)) | frozenset(_classes().values())


def perception(name: str) -> dict[str, Any]:
    """The settings of an installed perception.

    Raises:
        UserError: if there is none of that name.
    """
    if path := find("explain", "perception", f"{name}.yaml"):
        return _read(path)
    if name not in _classes():
        known = sorted({*stems("explain", "perception"), *_classes()})
        raise UserError(f"perception={name!r} is not installed: one of {', '.join(known)}")
    return {"_target_": _classes()[name]}


def load(target: str) -> type:
    """The class ``package.module.Class`` that an installed package names.

    Raises:
        UserError: if it cannot be imported, or is none.
    """
    module, _, name = target.rpartition(".")
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError as error:
        raise UserError(f"{target} cannot be imported ({error}): install what it needs") from None
    if not isinstance(found, type):
        raise UserError(f"{target} is no class: mend the package that names it")
    return found


class InstalledSettings(SearchPathPlugin):
    """Shows Hydra the folders of installed packages, so that ``+task=NAME`` finds theirs."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:  # noqa: D102 (Hydra's)
        for folder in folders()[1:]:
            search_path.append(TASKS, f"file://{folder}")


def register() -> None:
    """Makes what is installed known to Hydra."""
    Plugins.instance().register(InstalledSettings)
    for name, target in _classes().items():
        if find("explain", "perception", f"{name}.yaml") is None:
            ConfigStore.instance().store(group="explain/perception", name=name, node={"_target_": target})


def source_sha256(world: type) -> str:
    """SHA-256 of the modules beside a world's own: what is played in it stays the same while these do."""
    source = inspect.getsourcefile(world)
    if source is None:
        return ""
    digest = hashlib.sha256()
    for path in sorted(Path(source).parent.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def _points() -> Iterator[EntryPoint]:
    for group in (TASKS, PERCEPTION):
        yield from entry_points(group=group)


def _classes() -> dict[str, str]:
    return {point.name: f"{point.module}.{point.attr}" for point in entry_points(group=PERCEPTION) if point.attr}


def _folder(value: str) -> Path | None:
    """The ``conf`` of the package that an entry point names, found without running its code."""
    top, *inner = value.partition(":")[0].strip().split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    for place in (spec and spec.submodule_search_locations) or ():
        package = Path(place).joinpath(*inner)
        for folder in (package, *package.parents[: len(inner)]):
            if (folder / "conf").is_dir():
                return folder / "conf"
    return None


def _read(path: Path) -> dict[str, Any]:
    """What one file says; nothing of one that is broken, which Hydra tells whoever chooses it."""
    try:
        content = plain.read(path)
    except (UserError, OSError):
        return {}
    return content if isinstance(content, dict) else {}
