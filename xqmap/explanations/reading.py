"""Decision files of strangers: every mistake is named with its place, before anything is built."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from xqmap.errors import UserError
from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.terminal import one_line

_LARGEST_VALUE = 1e9
_LARGEST_WHOLE = 2**53


def _said(text: str) -> str:
    """Without control characters, which could move a terminal's cursor or hide text; a name has none."""
    if not text.strip():
        raise ValueError("must be a text that is not empty")
    return one_line(text) or "unnamed"


# What can still be read by a person, and drawn.
_Text = Annotated[str, Field(max_length=200), AfterValidator(_said)]
_Number = Annotated[float, Field(ge=-_LARGEST_VALUE, le=_LARGEST_VALUE, allow_inf_nan=False)]
_Whole = Annotated[int, Field(ge=-_LARGEST_WHOLE, le=_LARGEST_WHOLE)]
_Row = Annotated[float, Field(ge=0, le=_LARGEST_VALUE, allow_inf_nan=False)]
_Values = Annotated[dict[str, _Number], Field(max_length=32)]
# Of a value: what is paid now, and what follows by horizon.
MOST_PARTS = 102
_Ahead = Annotated[list[_Number], Field(min_length=1, max_length=MOST_PARTS - 1)]
# How far the sum of the parts may be from the value.
_TOLERANCE = 1e-4


class _Object(BaseModel):
    model_config = ConfigDict(strict=True)

    object: _Text
    values: _Values
    pixel: Annotated[list[_Row], Field(min_length=2, max_length=2)] | None = None
    position: Annotated[list[_Number], Field(min_length=3, max_length=3)] | None = None
    object_index: _Whole | None = None
    now: _Values | None = None
    when: Annotated[dict[str, _Ahead], Field(max_length=32)] | None = None


class _Candidate(_Object):
    label: _Text


class _Played(BaseModel):
    model_config = ConfigDict(strict=True)

    label: _Text
    returns: Annotated[list[_Values], Field(min_length=1, max_length=100)]


class _File(BaseModel):
    model_config = ConfigDict(strict=True)

    task: _Text
    components: Annotated[list[_Text], Field(min_length=1, max_length=32)]
    candidates: Annotated[list[_Candidate], Field(min_length=1, max_length=33)]
    objects: Annotated[list[_Object], Field(max_length=1000)] | None = None
    scene_seed: _Whole | None = None
    step: _Whole | None = None
    noise: _Values | None = None
    played: Annotated[list[_Played], Field(max_length=33)] | None = None


def parse(content: Any, source: str) -> dict[str, Any]:
    """The fields of the decision that the content of a ``decision.json`` tells of.

    Args:
        content: what the JSON holds.
        source: what messages call it, its path.

    Raises:
        UserError: naming ``source`` and the place that is wrong.
    """
    try:
        file = _File.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{source}: {first_mistake(error)}") from None

    def refuse(place: str, why: str) -> None:
        raise UserError(f"{source}: {place} {why}")

    components = tuple(file.components)
    if len(set(components)) < len(components):
        refuse("components", "names one twice")

    def parts(entry: _Object, place: str) -> dict[str, list[float]] | None:
        if entry.now is None:
            return None
        later = {name: entry.values[name] - entry.now[name] for name in components}
        if entry.when is None:
            ahead = {name: [value] if any(later.values()) else [] for name, value in later.items()}
        else:
            ahead = {name: entry.when[name] for name in components}
            if len({len(numbers) for numbers in ahead.values()}) > 1:
                refuse(f"{place}.when", "must name as many numbers for every component")
            if any(abs(sum(ahead[name]) - later[name]) > _TOLERANCE for name in components):
                refuse(f"{place}.when", "must add up to what is left of the values without now")
        return {name: [entry.now[name], *ahead[name]] for name in components}

    def candidate(entry: _Object, label: str, place: str) -> Candidate:
        named: Mapping[str, Any] | None
        for part, named in (("values", entry.values), ("now", entry.now), ("when", entry.when)):
            if named is None:
                continue
            for name in components:
                if name not in named:
                    refuse(f"{place}.{part}", f"lacks the component {name!r}")
            for name in named:
                if name not in components:
                    refuse(f"{place}.{part}", f"has {one_line(name)!r}, which is not among the components")
        row, column = entry.pixel or (0, 0)
        x, y, z = entry.position or (0.0, 0.0, 0.0)
        return Candidate(
            label,
            entry.object,
            {name: entry.values[name] for name in components},
            (int(row), int(column)) if entry.pixel else None,
            (x, y, z) if entry.position else None,
            entry.object_index,
            parts(entry, place),
        )

    candidates: list[Candidate] = []
    for i, entry in enumerate(file.candidates):
        if entry.label in {known.label for known in candidates}:
            refuse(f"candidates[{i}].label", f"repeats {entry.label!r}")
        candidates.append(candidate(entry, entry.label, f"candidates[{i}]"))
    if SELECTED not in {candidate.label for candidate in candidates}:
        refuse("candidates", f"has none with the label {SELECTED!r}")
    candidates.sort(key=lambda candidate: candidate.label != SELECTED)
    objects = [candidate(entry, entry.object, f"objects[{i}]") for i, entry in enumerate(file.objects or [])]
    for i, future in enumerate(file.played or []):
        if future.label not in {known.label for known in candidates}:
            refuse(f"played[{i}].label", f"names {future.label!r}, which is no candidate")
        if any(set(returns) != set(components) for returns in future.returns):
            refuse(f"played[{i}].returns", f"must name the components: {', '.join(components)}")
    noise = file.noise or {}
    return {
        "task": file.task,
        "components": components,
        "candidates": candidates,
        "scene_seed": file.scene_seed,
        "objects": sorted(objects, key=lambda thing: -thing.overall),
        "step": file.step or 0,
        "played": {future.label: future.returns for future in file.played or []},
        "noise": {name: abs(noise[name]) for name in components if name in noise},
    }


def first_mistake(error: ValidationError) -> str:
    """The first mistake in a file, as its place and what is wrong there, in one line."""
    first = error.errors()[0]
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in first["loc"]).lstrip(".")
    return one_line(f"{place or 'the file'} {_why(first)}")


def _why(mistake: ErrorDetails) -> str:
    found = mistake.get("ctx", {})
    match mistake["type"]:
        case "missing":
            return "is missing"
        case "value_error":
            return str(found["error"])
        case "string_type":
            return "must be a text that is not empty"
        case "string_too_long":
            return f"is longer than {found['max_length']} characters"
        case "list_type":
            return "must be a list that is not empty"
        case "too_short":
            least = found["min_length"]
            return f"must be a list of {least} numbers" if least > 1 else "must be a list that is not empty"
        case "too_long":
            return f"has more than {found['max_length']} entries"
        case "float_type" if type(mistake["input"]) is not int:
            return "must be a number"
        case "float_type" | "finite_number" | "greater_than_equal" | "less_than_equal":
            least = found.get("ge", -_LARGEST_VALUE)
            return (
                "must be 0 or more" if least == 0 else f"must be a finite number of at most {_LARGEST_VALUE:g} in size"
            )
        case "model_type" | "dict_type":
            return (
                "must be an object"
                if mistake["loc"]
                else "must hold a JSON object with task, components and candidates"
            )
    return mistake["msg"]
