"""What the settings of a world take: said once, by the annotations of its ``__init__``, and held to before it runs."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from pydantic import ConfigDict, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema

Init = TypeVar("Init", bound=Callable[..., None])
# A value that is longer is cut where a message shows it.
SHOWN = 80
# How a message calls a number, a whole one, and pairs of them.
NUMBERS = {
    float: "",
    int: " (a whole number)",
    tuple[float, float]: " (two numbers, the smaller one first)",
    tuple[int, int]: " (two whole numbers, the smaller one first)",
}


class SettingError(ValueError):
    """A setting does not fit: one line that begins with its name, which is ``setting``, too."""

    def __init__(self, setting: str, problem: str) -> None:
        super().__init__(f"{setting} {problem}")
        self.setting = setting


@dataclass(frozen=True)
class Within:
    """Marks a number that lies from ``low`` to ``high``, or a pair of such numbers of which the first is not above the
    second.
    """

    low: float
    high: float

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._held, handler(source))

    def _held(self, value: Any) -> Any:
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(self.low <= number <= self.high for number in numbers) or list(numbers) != sorted(numbers):
            raise ValueError
        return value

    def __str__(self) -> str:
        low, high = (f"{bound:g}" if isinstance(bound, float) else str(bound) for bound in (self.low, self.high))
        return f"between {low} and {high}"


class Check:
    """Holds values against a type annotation, strictly: no text for a number, no 1.0 for a whole one, nothing that is
    not finite.
    """

    def __init__(self, annotation: Any) -> None:
        self._annotation = annotation
        self._adapter = TypeAdapter(
            annotation, config=ConfigDict(strict=True, allow_inf_nan=False, arbitrary_types_allowed=True)
        )

    def __call__(self, setting: str, value: Any) -> Any:
        """The value, a list as a tuple where that is what is asked for.

        Raises:
            SettingError: if it does not fit.
        """
        for candidate in (value, tuple(value)) if isinstance(value, list) else (value,):
            try:
                return self._adapter.validate_python(candidate)
            except (ValidationError, OverflowError):
                continue
        raise SettingError(setting, f"must be {self}, not {_shown(value)}")

    def __str__(self) -> str:
        kind, *marks = get_args(self._annotation) if get_origin(self._annotation) is Annotated else (self._annotation,)
        if get_origin(kind) is Literal:
            *choices, last = ("null" if choice is None else choice for choice in get_args(kind))
            return f"{', '.join(choices)} or {last}"
        if bounds := next((mark for mark in marks if isinstance(mark, Within)), None):
            return f"{bounds}{NUMBERS[kind]}"
        said = next((mark for mark in marks if isinstance(mark, str)), None)
        return said or f"of the type {getattr(kind, '__name__', None) or kind}"


def checks(function: Callable[..., Any]) -> dict[str, Check]:
    """A check for each of a function's parameters that has an annotation, but ``**kwargs``."""
    named = {
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind != parameter.VAR_KEYWORD
    }
    hints = get_type_hints(function, include_extras=True)
    return {name: Check(hint) for name, hint in hints.items() if name in named}


def checked(init: Init) -> Init:
    """Lets an ``__init__`` with keyword arguments run only with settings that are what its annotations say.

    An annotation is a type, a ``Literal``, or ``Annotated`` with :class:`Within` or a text that says what is taken.

    Raises:
        SettingError: naming the first setting that does not fit or has no value, before anything of ``init`` runs.
    """
    all_checks = checks(init)
    required = [
        name for name, parameter in inspect.signature(init).parameters.items() if parameter.default is parameter.empty
    ]

    @wraps(init)
    def run(self: Any, **settings: Any) -> None:
        for name, check in all_checks.items():
            if name in settings:
                settings[name] = check(name, settings[name])
            elif name in required:
                raise SettingError(name, f"must be {check}, but has no value")
        init(self, **settings)

    return run  # type: ignore[return-value]


def _shown(value: Any) -> str:
    """A value as one writes it in a setting, cut after ``SHOWN`` characters."""
    try:
        text = json.dumps(value, default=repr)
    except (ValueError, TypeError, RecursionError):
        # A circle, or a number of more digits than Python prints.
        text = f"this {type(value).__name__}"
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
