"""Where the objects of a scene are put down. Lengths in metres."""

from __future__ import annotations

import numpy as np

from .agents.ur5e import joints_at
from .tabletop import COLORS, CUBE, MASS, RADIUS, RANK, TOP, Thing
from .workcell import BOUNDS

# Least distance between the circles around two objects.
GAP = {"spread": 0.04, "cluttered": 0.003, "stacked": 0.04}
# How often, in a stacked layout, a cube stands on another while there is one.
STACKED = 0.8
# The share of a cluttered heap's disc that the objects' circles cover, at first.
DENSITY = 0.5
TRIES = 100
# Layouts drawn before a scene is given up.
LAYOUTS = 200


def reachable_layout(
    rng: np.random.RandomState, count: int, layout: str, tint: float, hover: float, home: np.ndarray
) -> tuple[list[Thing], int]:
    """A layout in the workspace whose objects the arm can all reach, and how many were drawn in vain before it.

    Args:
        rng: source of the draw.
        count: how many objects.
        layout: as :func:`sample_layout` has it.
        tint: likewise.
        hover: height of the cup over the table on its way.
        home: ``[6]``: the arm's joint angles at home (rad).

    Raises:
        ValueError: if there is none among ``LAYOUTS``.
    """
    for rejected in range(LAYOUTS):
        things = sample_layout(rng, count, layout, BOUNDS, tint)
        if all(reaches(thing, hover, home) for thing in things):
            return things, rejected
    raise ValueError(f"no layout within the arm's reach in {LAYOUTS} draws: lower task.env.hover or task.env.objects")


def reaches(thing: Thing, hover: float, home: np.ndarray) -> bool:
    """Whether the arm's inverse kinematics has a solution on top of an object and above it."""
    try:
        joints_at(np.array([[thing.x, thing.y, z] for z in (hover, TOP[thing.kind] + CUBE * thing.level)]), home)
    except ValueError:
        return False
    return True


def sample_layout(rng: np.random.RandomState, count: int, layout: str, bounds: np.ndarray, tint: float) -> list[Thing]:
    """``count`` objects of random kind, color, place and yaw, at least one of them a cube.

    Args:
        rng: source of the draw.
        count: how many.
        layout: ``"spread"`` over the table; ``"cluttered"``: close together around a random place; ``"stacked"``:
            spread, and most cubes stand two by two, the one of the lower color on top.
        bounds: ``[≥2, 2]``, lowest and highest x and y of the table's part they may lie on.
        tint: most that is added to or taken from each of red, green and blue, 8-bit.
    """
    kinds = [str(kind) for kind in rng.choice(list(MASS), count)]
    if "cube" not in kinds:
        kinds[rng.randint(count)] = "cube"
    colors = [str(color) for color in rng.choice(list(COLORS), count)]
    tints = rng.uniform(-tint, tint, (count, 3))
    under = _stacks(rng, kinds, colors) if layout == "stacked" else {}
    radii = np.array([0.0 if i in under else RADIUS[kind] for i, kind in enumerate(kinds)])
    low, high = np.asarray(bounds)[:2].T
    gap = GAP[layout]
    heap = np.sqrt((radii**2).sum() / DENSITY) if layout == "cluttered" else np.inf
    while True:
        middle = rng.uniform(low, high)
        places: list[np.ndarray] = []
        for i, radius in enumerate(radii):
            if i in under:
                places.append(np.full(2, np.inf))  # where the one below comes to be
                continue
            near = np.maximum(low + radius, middle - heap), np.minimum(high - radius, middle + heap)
            for _ in range(TRIES):
                place = rng.uniform(*near)
                apart = all(
                    np.hypot(*(place - other)) > radius + far + gap for other, far in zip(places, radii, strict=False)
                )
                if apart and np.hypot(*(place - middle)) <= heap:
                    places.append(place)
                    break
            else:
                break
        if len(places) == count:
            break
        # Too many for this much room: a little closer together, or a larger heap.
        gap, heap = (gap, heap * 1.03) if layout == "cluttered" else (gap * 0.9, heap)
    yaws = rng.uniform(0, 360, count)
    for top, base in under.items():
        places[top], yaws[top] = places[base], yaws[base]
    return [
        Thing(kind, color, float(place[0]), float(place[1]), float(yaw), (float(red), float(green), float(blue)), level)
        for kind, color, place, yaw, (red, green, blue), level in zip(
            kinds, colors, places, yaws, tints, [int(i in under) for i in range(count)], strict=True
        )
    ]


def _stacks(rng: np.random.RandomState, kinds: list[str], colors: list[str]) -> dict[int, int]:
    """Which cube stands on which, by their places: of each pair the one of the lower color on the other."""
    cubes, under = [i for i, kind in enumerate(kinds) if kind == "cube"], {}
    while len(cubes) > 1:
        first = cubes.pop()
        if rng.rand() < STACKED:
            top, base = sorted((first, cubes.pop()), key=lambda i: RANK[colors[i]])
            under[top] = base
    return under
