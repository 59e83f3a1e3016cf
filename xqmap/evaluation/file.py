"""The file of an evaluation: its place, and what one that may be a stranger's has to hold to be counted with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from xqmap.errors import UserError
from xqmap.files import read_bytes

# Bytes of an evaluation; one of a thousand seeds has a few hundred thousand.
_LARGEST_FILE = 20_000_000
# Of numbers in an evaluation.
_LARGEST = 1e12


def evaluation_file(directory: Path, sheet: str | None = None) -> Path:
    """Where the evaluation of a run is written: ``evaluation.json``, of a sheet ``evaluation-<sheet>.json``."""
    return directory / (f"evaluation-{sheet}.json" if sheet else "evaluation.json")


def is_number(value: Any) -> bool:
    """Whether this is a number that can be reckoned with: NaN is, infinity and what no count or reward comes near are
    not.
    """
    return isinstance(value, int | float) and not isinstance(value, bool) and not abs(value) > _LARGEST


def _reckoned(number: float) -> float:
    if not is_number(number):
        raise ValueError("is no number that can be reckoned with")
    return number


def _printed(name: str) -> str:
    # Control characters could move a terminal's cursor; half a character cannot be written at all.
    if not name.isprintable():
        raise ValueError("cannot be printed")
    return name


_Name = Annotated[str, AfterValidator(_printed)]
_Number = Annotated[float, AfterValidator(_reckoned)]
_Count = Annotated[int, Field(ge=0, le=10**9)]


class _Run(BaseModel):
    model_config = ConfigDict(strict=True)

    choices: _Count
    correct: _Count
    regret: _Number
    components: dict[_Name, _Number] = {}

    @model_validator(mode="after")
    def _counted(self) -> _Run:
        if self.correct > self.choices:
            raise ValueError("has more that are correct than choices")
        return self


class _Baseline(BaseModel):
    model_config = ConfigDict(strict=True)

    mean: _Number
    std: _Number
    choices: _Number
    ci95: Annotated[list[_Number], Field(min_length=2, max_length=2)]
    regret: _Number = 0.0


class _Evaluation(BaseModel):
    model_config = ConfigDict(strict=True)

    task: _Name
    method: _Name
    training_seed: int
    runs: list[_Run]
    baselines: dict[_Name, _Baseline] | None = None
    confusion: dict[_Name, dict[_Name, _Number]] | None = None


def read(path: Path) -> dict[str, Any]:
    """The content of an evaluation's file.

    Raises:
        UserError: naming the file, and why it cannot be counted.
    """
    try:
        content = json.loads(read_bytes(path, _LARGEST_FILE, inside=path.parent))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not JSON ({str(error)[:80]})") from None
    if why := wrong(content):
        raise UserError(f"{path}: {why}")
    assert isinstance(content, dict)
    return content


def wrong(content: Any) -> str:
    """Why this is not an evaluation that can be counted; empty if it is one."""
    try:
        runs = _Evaluation.model_validate(content).runs
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        return f"no evaluation of xqmap: {place or 'the file'}: {first.get('ctx', {}).get('error') or first['msg']}"
    return "" if any(run.choices for run in runs) else "no choice was made in it"
