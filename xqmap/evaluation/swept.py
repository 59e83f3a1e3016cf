"""Settings of trainings side by side: by dotted names, which of them differ, and how they are told apart."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol, TypeVar

# Settings that say where and how often a method ran, not what it is: they never split a group of runs.
NOT_SWEPT = ("seed", "device", "threads", "resume", "logger")

T = TypeVar("T")


class Trained(Protocol):
    """What can be told apart by its settings."""

    settings: dict[str, Any]

    @property
    def task(self) -> str: ...  # noqa: D102

    @property
    def method(self) -> str: ...  # noqa: D102


def flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    """A nested dictionary by dotted names; lists are values."""
    if not isinstance(tree, dict) or (not tree and prefix):
        return {prefix: tree}
    return {
        name: value
        for key, inner in tree.items()
        for name, value in flat(inner, f"{prefix}.{key}" if prefix else str(key)).items()
    }


def differing(settings: Iterable[dict[str, Any]]) -> list[str]:
    """The names whose values are not the same in all of these settings, in the order they first appear."""
    every = [entry for entry in settings if entry]
    names = dict.fromkeys(name for entry in every for name in entry)
    return [name for name in names if len({repr(entry.get(name)) for entry in every}) > 1]


def swept(trainings: Sequence[Trained]) -> dict[str, list[str]]:
    """By task: the settings that differ between trainings of one method and are neither its seed nor its machine.

    Only as many as tell them apart: what changes along with those named says no more. A setting that one of the
    trainings does not have was not swept: it is newer than that training.
    """
    names: dict[str, dict[str, None]] = {}
    for group in grouped(trainings, lambda t: (t.task, t.method)).values():
        known = [t.settings for t in group if t.settings]
        kept: list[str] = []
        for name in differing(known):
            if name.split(".")[0] not in NOT_SWEPT and all(name in settings for settings in known):
                apart = (len({repr([s[n] for n in chosen]) for s in known}) for chosen in (kept, [*kept, name]))
                kept += [name] if next(apart) < next(apart) else []
        names.setdefault(group[0].task, {}).update(dict.fromkeys(kept))
    return {task: list(found) for task, found in names.items()}


def label(name: str, settings: dict[str, Any]) -> str:
    """A method's name with the swept settings behind it."""
    return ", ".join([name, *(f"{shown(key)}={shown(value)}" for key, value in settings.items())])


def shown(value: Any) -> str:
    """A setting's value as it stands on a command line; what cannot be printed, in JSON's spelling."""
    return "null" if value is None else value if isinstance(value, str) and value.isprintable() else json.dumps(value)


def grouped(things: Iterable[T], key: Callable[[T], Any]) -> dict[Any, list[T]]:
    """Things by their key, in the order they come."""
    groups: dict[Any, list[T]] = {}
    for thing in things:
        groups.setdefault(key(thing), []).append(thing)
    return groups
