"""What a world's settings take: anything else is one line, before a simulator is started."""

from __future__ import annotations

from functools import wraps
from typing import Annotated, Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mani_skill.envs.sapien_env import BaseEnv

from tasks.base import DecisionEnv
from tasks.grasping import GraspingEnv
from tasks.landing import LandingEnv
from tasks.settings import SHOWN, SettingError, Within, checked
from tests.settings import world_settings
from xqmap.config import build
from xqmap.errors import UserError

WORLDS: dict[str, type[DecisionEnv]] = {"landing": LandingEnv, "grasping": GraspingEnv}
SETTINGS = {task: world_settings(task) for task in WORLDS}
# What every world has besides.
SHARED = ("weights", "render_backend", "render_mode", "sim_config", "enable_shadow", "num_envs", "wind")

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([10**400, 2**63, -1, 0, 1]),
    st.floats(),
    st.floats(0, 50),
    st.integers(0, 50),
    st.text(max_size=20),
    st.sampled_from(["1", "null", "rim", "spread", "x" * 10_000, "a\nb", "\x1b[31m"]),
)
junk = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.tuples(inner, inner), st.dictionaries(st.text(max_size=5), inner, max_size=2)
    ),
    max_leaves=4,
)


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What simulators were started with: none is, really."""
    calls: list[dict[str, Any]] = []

    @wraps(BaseEnv.__init__)
    def start(self: BaseEnv, **settings: Any) -> None:
        calls.append(settings)

    monkeypatch.setattr(BaseEnv, "__init__", start)
    return calls


def refused(task: str, name: str, value: Any) -> str:
    """The line that a setting ends in; empty if it is taken."""
    try:
        WORLDS[task](**SETTINGS[task] | {name: value})
    except SettingError as error:
        assert error.setting == name
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("task", "name", "value", "line"),
    [
        ("landing", "blocks", [5], "between 0 and 200 (two whole numbers, the smaller one first), not [5]"),
        ("landing", "blocks", 5, "between 0 and 200 (two whole numbers, the smaller one first), not 5"),
        (
            "landing",
            "blocks",
            ["a", "b"],
            'between 0 and 200 (two whole numbers, the smaller one first), not ["a", "b"]',
        ),
        ("landing", "blocks", [9, 3], "between 0 and 200 (two whole numbers, the smaller one first), not [9, 3]"),
        ("landing", "blocks", [True, 3], "between 0 and 200 (two whole numbers, the smaller one first), not [true, 3]"),
        ("landing", "incline_deg", [8, 80], "between 0 and 45 (two numbers, the smaller one first), not [8, 80]"),
        ("landing", "incline_deg", [], "between 0 and 45 (two numbers, the smaller one first), not []"),
        ("landing", "altitude", None, "between 10 and 30, not null"),
        ("landing", "altitude", float("nan"), "between 10 and 30, not NaN"),
        ("landing", "altitude", "20", 'between 10 and 30, not "20"'),
        ("landing", "inclined_share", True, "between 0 and 1, not true"),
        ("landing", "image_size", 300.5, "between 168 and 4096 (a whole number), not 300.5"),
        ("landing", "control_steps", float("inf"), "between 1 and 10000 (a whole number), not Infinity"),
        ("grasping", "objects", [31, 31], "between 1 and 30 (two whole numbers, the smaller one first), not [31, 31]"),
        ("grasping", "light", 3, "between 0 and 2, not 3"),
        ("grasping", "depth_noise", -1, "between 0 and 0.1, not -1"),
        ("grasping", "hover", 0.5, "between 0.09 and 0.4, not 0.5"),
        ("grasping", "attempts", 0, "between 1 and 10000 (a whole number), not 0"),
        ("grasping", "layout", "heap", 'spread, cluttered or stacked, not "heap"'),
        ("grasping", "failure", "again", 'ends, stays or removed, not "again"'),
        ("grasping", "seal", ["rim"], 'rim or touch, not ["rim"]'),
        ("landing", "render_backend", "none", 'auto, cpu, gpu or sapien_cuda:NUMBER, not "none"'),
        ("landing", "render_mode", "film", 'rgb_array, human, sensors, all or null, not "film"'),
        ("landing", "weights", {"color": -1.0}, 'numbers from 0 on by component, or null, not {"color": -1.0}'),
        ("landing", "enable_shadow", 3, "of the type bool, not 3"),
    ],
)
def test_the_line_says_what_is_taken_and_what_was_given(
    task: str, name: str, value: Any, line: str, started: list[dict[str, Any]]
) -> None:
    assert refused(task, name, value) == f"{name} must be {line}"
    assert not started


def test_a_number_with_more_digits_than_python_prints_is_refused(started: list[dict[str, Any]]) -> None:
    for value, shown in ((10**5000, "this int"), ([1, -(10**5000)], "this list")):
        assert refused("landing", "blocks", value).endswith(f", not {shown}")
    assert not started


@pytest.mark.parametrize("name", ["wind", "num_envs", "sim_backend"])
def test_a_setting_that_there_is_not_is_named(name: str, started: list[dict[str, Any]]) -> None:
    assert refused("landing", name, 1) == f"{name} is no setting of LandingEnv"
    assert not started


def test_a_weight_of_no_component_is_refused(started: list[dict[str, Any]]) -> None:
    assert refused("landing", "weights", {"colour": 2.0}) == "weights names 'colour', which is none of flatness, color"
    assert not started


# Agents were trained before there was this setting; they meant what it is without a value.
NEWER = [("grasping", "failure")]


@pytest.mark.parametrize(
    ("task", "name"), [(task, name) for task in WORLDS for name in SETTINGS[task] if (task, name) not in NEWER]
)
def test_a_setting_without_a_value_is_named(task: str, name: str) -> None:
    with pytest.raises(SettingError, match=f"^{name} must be .*, but has no value$"):
        WORLDS[task](**{other: value for other, value in SETTINGS[task].items() if other != name})


@given(data=st.data())
@pytest.mark.parametrize("task", list(WORLDS))
def test_whatever_is_given_either_fits_or_is_one_line(task: str, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from([*SETTINGS[task], *SHARED]))
    line = refused(task, name, data.draw(junk))
    assert not line or (line.startswith(f"{name} ") and line.isprintable() and len(line) < 150 + SHOWN)


@pytest.mark.parametrize(
    ("name", "value"), [("blocks", (0, 0)), ("incline_deg", [8, 35.0]), ("altitude", 10), ("image_size", 168)]
)
def test_bounds_belong_to_what_is_taken(name: str, value: Any, started: list[dict[str, Any]]) -> None:
    assert not refused("landing", name, value)
    assert started


def test_the_command_s_line_names_the_setting_in_full(toy_config: Any) -> None:
    cfg = toy_config()
    cfg.task.env = {"_target_": "xqmap_tasks.landing.LandingEnv", **SETTINGS["landing"], "blocks": [5]}
    cfg.task.weights = {"flatness": 1.0, "color": 1.0}
    with pytest.raises(UserError, match=r"^task\.env\.blocks must be between 0 and 200 .*, not \[5\]$"):
        build.task(cfg)


def test_a_world_of_one_s_own_says_what_it_takes_in_its_signature() -> None:
    class Own:
        @checked
        def __init__(
            self,
            *,
            speed: Annotated[float, Within(0.5, 2.0)],
            color: Literal["red", "blue"] = "red",
            place: Annotated[tuple[float, float, float] | None, "x, y and z (m), or null"] = None,
        ) -> None:
            self.speed, self.color, self.place = speed, color, place

    made = Own(speed=1, place=[0.0, 1, 2])
    assert (made.speed, made.color, made.place) == (1.0, "red", (0.0, 1.0, 2.0))
    for settings, line in (
        ({"speed": np.inf}, "speed must be between 0.5 and 2, not Infinity"),
        ({"speed": 1, "color": "gray"}, 'color must be red or blue, not "gray"'),
        ({"speed": 1, "place": [1, 2]}, r"place must be x, y and z \(m\), or null, not \[1, 2\]"),
        ({}, "speed must be between 0.5 and 2, but has no value"),
    ):
        with pytest.raises(SettingError, match=f"^{line}$"):
            Own(**settings)
