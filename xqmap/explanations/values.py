"""A decision of any agent with component values: between named actions, without a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xqmap.errors import UserError
from xqmap.explanations.candidate import SELECTED, Candidate, label

# As many as a decision file holds.
_MOST_ACTIONS = 1000


def read(
    q: Any,
    actions: Sequence[str],
    components: Sequence[str],
    weights: Sequence[float] | Mapping[str, float] | None,
    mask: Any,
    errors: Sequence[float] | Mapping[str, float] | None,
) -> dict[str, Any]:
    """The fields of the decision that values tell of; arguments as in
    :meth:`xqmap.explanations.Decision.from_values`.

    Raises:
        UserError: naming the argument that does not fit.
    """
    names, called = tuple(map(str, components)), tuple(map(str, actions))
    for what, given in (("components", names), ("actions", called)):
        if not given or len(set(given)) < len(given) or not all(name.strip() for name in given):
            raise UserError(f"{what}={list(given)} must be names, at least one, and none twice")
    if len(called) > _MOST_ACTIONS:
        raise UserError(f"{len(called)} actions are more than {_MOST_ACTIONS}: mask them and name those that are left")
    values = _array(q).astype(float)
    if values.shape != (len(names), len(called)):
        raise UserError(
            f"q is {list(values.shape)}, must be [{len(names)}, {len(called)}]: a value for each of the components "
            f"{', '.join(names)} and each of the {len(called)} actions"
        )
    allowed = np.ones(len(called), bool) if mask is None else _array(mask).astype(bool)
    if allowed.shape != (len(called),) or not allowed.any():
        raise UserError(f"mask must be {len(called)} truth values, one for each action, and allow at least one")
    if not np.isfinite(values[:, allowed]).all():
        raise UserError("q holds NaN or infinite values of actions that can be chosen: give finite ones, or mask them")
    values = values * np.array(_in_order(weights, names, "weights", 1.0))[:, None]
    things = [
        Candidate(action, action, dict(zip(names, values[:, i].tolist(), strict=True)), object_index=i)
        for i, action in enumerate(called)
        if allowed[i]
    ]
    best = [max(things, key=lambda thing: thing.overall)]
    best += [max(things, key=lambda thing, name=name: thing.values[name]) for name in names]  # type: ignore[misc]
    labels = [SELECTED, *(label(k) for k in range(len(names)))]
    return {
        "components": names,
        "candidates": [
            Candidate(mark, thing.object, thing.values, object_index=thing.object_index)
            for mark, thing in zip(labels, best, strict=True)
        ],
        "objects": sorted(things, key=lambda thing: -thing.overall),
        "noise": {} if errors is None else dict(zip(names, _in_order(errors, names, "errors", 0.0), strict=True)),
    }


def _array(values: Any) -> np.ndarray:
    # A tensor may need gradients, or lie on a GPU.
    return np.asarray(values.detach().cpu() if hasattr(values, "detach") else values)


def _in_order(
    given: Sequence[float] | Mapping[str, float] | None, names: tuple[str, ...], what: str, default: float
) -> list[float]:
    if isinstance(given, Mapping):
        if unknown := set(given) - set(names):
            raise UserError(f"{what} names {sorted(unknown)}; the components are {list(names)}")
        given = [given.get(name, default) for name in names]
    numbers = [default] * len(names) if given is None else [float(value) for value in given]
    if len(numbers) != len(names) or not all(np.isfinite(value) and value >= 0 for value in numbers):
        raise UserError(f"{what}={numbers} must be {len(names)} finite numbers of 0 or more, one for each component")
    return numbers
