"""Decision files of strangers: every mistake is named with its place, before anything is built."""

from __future__ import annotations

from typing import Any

from xqmap.errors import UserError
from xqmap.explanations.candidate import SELECTED, Candidate

_LONGEST_NAME = 200
# Of entries in a list: what can still be read by a person, and drawn.
_MOST = {"components": 32, "candidates": 33, "objects": 1000}
_LARGEST_VALUE = 1e9


def parse(content: Any, source: str) -> dict[str, Any]:
    """The fields of the decision that the content of a ``decision.json`` tells of.

    Args:
        content: what the JSON holds.
        source: what messages call it, its path.

    Raises:
        UserError: naming ``source`` and the place that is wrong.
    """

    def wrong(place: str, why: str) -> UserError:
        return UserError(f"{source}: {place} {why}")

    def text(value: Any, place: str) -> str:
        if not isinstance(value, str) or not value.strip():
            raise wrong(place, "must be a text that is not empty")
        if len(value) > _LONGEST_NAME:
            raise wrong(place, f"is longer than {_LONGEST_NAME} characters")
        # Control characters could move a terminal's cursor or hide text; a name has none.
        return " ".join("".join(c if c.isprintable() else " " for c in value).split()) or "unnamed"

    def number(value: Any, place: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise wrong(place, "must be a number")
        # Not a float yet: a whole number of JSON may be too large to be one. Nor is NaN at most anything.
        if not abs(value) <= _LARGEST_VALUE:
            raise wrong(place, f"must be a finite number of at most {_LARGEST_VALUE:g} in size")
        return float(value)

    def numbers(value: Any, count: int, place: str) -> tuple[float, ...] | None:
        if value is None:
            return None
        if not isinstance(value, list) or len(value) != count:
            raise wrong(place, f"must be a list of {count} numbers")
        return tuple(number(v, f"{place}[{i}]") for i, v in enumerate(value))

    def whole(value: Any) -> int | None:
        return value if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53 else None

    if not isinstance(content, dict):
        raise wrong("the file", "must hold a JSON object with task, components and candidates")
    for key in ("task", "components", "candidates"):
        if key not in content:
            raise wrong(key, "is missing")
    for key in ("components", "candidates"):
        if not isinstance(content[key], list) or not content[key]:
            raise wrong(key, "must be a list that is not empty")
        if len(content[key]) > _MOST[key]:
            raise wrong(key, f"has more than {_MOST[key]} entries")
    components = tuple(text(name, f"components[{i}]") for i, name in enumerate(content["components"]))
    if len(set(components)) < len(components):
        raise wrong("components", "names one twice")

    def candidate(entry: Any, place: str, known_as: str) -> Candidate:
        if not isinstance(entry, dict):
            raise wrong(place, f"must be an object with {known_as} and values")
        thing = text(entry.get("object"), f"{place}.object")
        values = entry.get("values")
        if not isinstance(values, dict):
            raise wrong(f"{place}.values", "must be an object with a number per component")
        for name in components:
            if name not in values:
                raise wrong(f"{place}.values", f"lacks the component {name!r}")
        for name in values:
            if name not in components:
                raise wrong(f"{place}.values", f"has {name!r}, which is not among the components")
        pixel, position = (
            numbers(entry.get("pixel"), 2, f"{place}.pixel"),
            numbers(entry.get("position"), 3, f"{place}.position"),
        )
        if pixel and min(pixel) < 0:
            raise wrong(f"{place}.pixel", "must be a row and a column from 0 on")
        return Candidate(
            text(entry.get("label"), f"{place}.label") if "label" in known_as else thing,
            thing,
            {name: number(values[name], f"{place}.values.{name}") for name in components},
            (int(pixel[0]), int(pixel[1])) if pixel else None,
            (position[0], position[1], position[2]) if position else None,
            whole(entry.get("object_index")),
        )

    candidates: list[Candidate] = []
    for i, entry in enumerate(content["candidates"]):
        read = candidate(entry, f"candidates[{i}]", "label, object")
        if read.label in {known.label for known in candidates}:
            raise wrong(f"candidates[{i}].label", f"repeats {read.label!r}")
        candidates.append(read)
    if SELECTED not in {candidate.label for candidate in candidates}:
        raise wrong("candidates", f"has none with the label {SELECTED!r}")
    candidates.sort(key=lambda candidate: candidate.label != SELECTED)
    listed = content.get("objects") or []
    if not isinstance(listed, list) or len(listed) > _MOST["objects"]:
        raise wrong("objects", f"must be a list of at most {_MOST['objects']} entries")
    objects = [candidate(entry, f"objects[{i}]", "object") for i, entry in enumerate(listed)]
    seed, step, noise = content.get("scene_seed"), content.get("step"), content.get("noise")
    return {
        "task": text(content["task"], "task"),
        "components": components,
        "candidates": candidates,
        "scene_seed": whole(seed),
        "objects": sorted(objects, key=lambda thing: -thing.overall),
        "step": whole(step) or 0,
        "noise": {name: abs(number(noise[name], f"noise.{name}")) for name in components if name in noise}
        if isinstance(noise, dict)
        else {},
    }
