"""What is paid now and what can follow stand apart, add up, and are spoken of where something follows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from xqmap.errors import UserError
from xqmap.explanations import Candidate, Decision
from xqmap.explanations.views import plots
from xqmap.explanations.views.page import page
from xqmap.explanations.views.sentences import why

NAMES = ("shape", "color")


def candidate(
    label: str, thing: str, now: tuple[float, float] | None, later: tuple[float, float], at: int
) -> Candidate:
    paid = None if now is None else dict(zip(NAMES, now, strict=True))
    values = {name: (paid[name] if paid else 0.0) + more for name, more in zip(NAMES, later, strict=True)}
    parts = None if paid is None else {name: [paid[name], more] for name, more in zip(NAMES, later, strict=True)}
    return Candidate(label, thing, values, (at, at), None, at, parts)


def decision(noise: float = 0.1, **things: tuple[str, tuple[float, float] | None, tuple[float, float]]) -> Decision:
    made = [candidate(label, *what, at) for at, (label, what) in enumerate(things.items())]
    return Decision("foresight", NAMES, made, noise=dict.fromkeys(NAMES, noise))


CUBE = ("red cube", (1.0, 0.0), (1.7, 2.4))
BOWL = ("purple bowl", (0.0, 1.6), (0.0, 0.0))


def test_now_and_later_add_up_and_so_do_their_differences() -> None:
    made = decision(Selected=CUBE, B=BOWL)
    for each in made.candidates:
        assert each.now is not None and each.later is not None
        assert {name: each.now[name] + each.later[name] for name in NAMES} == pytest.approx(each.values)
    sooner = made.sooner("Selected", "B")
    assert sooner == {"shape": 1.0, "color": -1.6}
    assert made.foresees


def test_the_sentence_says_what_pays_less_now_and_more_later() -> None:
    said = decision(Selected=CUBE, B=BOWL).sentences()
    assert said["future"].startswith("The red cube pays 1.00 now (shape 1.00); 4.10 more can follow it")
    (contrast,) = said["contrastive"]
    assert (
        "It pays less now (shape +1.00 and color -1.60), but more can follow it (shape +1.70 and color +2.40)."
        in contrast
    )
    assert "After the purple bowl I expect nothing more." in contrast


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        (((1.0, 1.0), (1.0, 1.0)), ((0.0, 1.0), (1.0, 1.0)), "what they pay now; what can follow"),
        (((1.0, 1.0), (1.0, 1.0)), ((1.0, 1.0), (0.0, 1.0)), "They pay about the same now"),
        (((1.0, 1.0), (1.0, 1.0)), ((0.0, 1.0), (0.0, 1.0)), "It pays more now (shape +1.00), and more"),
        (((2.0, 1.0), (0.0, 1.0)), ((0.0, 1.0), (1.0, 1.0)), "It pays more now (shape +2.00), though less"),
    ],
)
def test_each_kind_of_difference_has_its_words(first: tuple, second: tuple, said: str) -> None:
    made = decision(Selected=("red cube", *first), B=("blue cube", *second))
    (contrast,) = made.sentences()["contrastive"]
    assert said in contrast and "I expect nothing more" not in contrast


def test_a_future_below_the_error_of_the_values_is_none() -> None:
    said = decision(0.5, Selected=("red cube", (1.0, 0.0), (0.2, 0.1)), B=("purple bowl", (0.0, 0.3), (0.0, 0.0)))
    assert said.sentences()["future"].startswith("All I expect of the red cube is paid now")


@pytest.mark.parametrize("now", [None, (1.0, 0.0)])
def test_where_nothing_follows_nothing_is_said_or_drawn_of_it(now: tuple[float, float] | None) -> None:
    made = decision(
        Selected=("red cube", now, (0.0, 0.0)), B=("purple bowl", None if now is None else (0.0, 0.3), (0.0, 0.0))
    )
    assert not made.foresees
    text = why(made)
    assert "follow it" not in text and "future" not in made.sentences()
    assert "can follow" not in labels(made)


def labels(made: Decision) -> list[str]:
    return [
        text.get_text() for axis in plots.bars(made).axes if axis.get_legend() for text in axis.get_legend().get_texts()
    ]


def test_bars_are_solid_up_to_what_is_paid_now() -> None:
    made = decision(Selected=CUBE, B=BOWL)
    axis = plots.values(made).axes[0]
    solid = [bar for bar in axis.patches if not bar.get_hatch()]
    hatched = [bar for bar in axis.patches if bar.get_hatch()]
    assert sorted(bar.get_height() for bar in solid) == pytest.approx([0.0, 0.0, 1.0, 1.6])
    assert sorted(bar.get_height() for bar in hatched) == pytest.approx([0.0, 0.0, 1.7, 2.4])
    tops = {round(bar.get_y() + bar.get_height(), 6) for bar in hatched}
    assert {2.7, 2.4} <= tops
    assert {"paid now", "can follow"} <= set(labels(made))


def test_the_file_holds_the_parts_and_the_page_shows_them(tmp_path: Path) -> None:
    made = decision(Selected=CUBE, B=BOWL)
    made.played = {"B": [{"shape": 0.0, "color": 2.0}, {"shape": 0.0, "color": 1.0}]}
    made.save(tmp_path / "decision.json")
    written = json.loads((tmp_path / "decision.json").read_text())["candidates"][0]
    assert (written["now"], written["later"]) == (
        {"shape": 1.0, "color": 0.0},
        pytest.approx({"shape": 1.7, "color": 2.4}),
    )
    read = Decision.load(tmp_path / "decision.json")
    assert read.played == made.played
    for ours, theirs in zip(read.candidates, made.candidates, strict=True):
        assert (ours.now, ours.later) == (theirs.now, theirs.later)
    assert why(read) == why(made)
    assert "2.70 (1.00 <wbr>+1.70)" in page([read])
    assert "2 times and gone on with to the end, the purple bowl (B) brought 1.50 (color 1.50);" in why(read)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"now": {"shape": 1.0}}, r"candidates\[0\].now lacks the component 'color'"),
        ({"now": {"shape": 1.0, "color": 0.0, "size": 1.0}}, r"candidates\[0\].now has 'size'"),
        ({"now": {"shape": "much", "color": 0.0}}, r"candidates\[0\].now"),
    ],
)
def test_parts_that_are_none_are_refused(tmp_path: Path, changed: dict, said: str) -> None:
    content = decision(Selected=CUBE, B=BOWL).to_dict()
    content["candidates"][0] |= changed
    (tmp_path / "decision.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match=said):
        Decision.load(tmp_path / "decision.json")


def test_returns_of_what_is_no_candidate_are_refused(tmp_path: Path) -> None:
    content = decision(Selected=CUBE, B=BOWL).to_dict()
    for played, said in (
        ([{"label": "Z", "returns": [{"shape": 0.0, "color": 0.0}]}], "no candidate"),
        ([{"label": "B", "returns": [{"shape": 0.0}]}], "must name the components"),
        ([{"label": "B", "returns": []}], "returns"),
    ):
        (tmp_path / "decision.json").write_text(json.dumps(content | {"played": played}))
        with pytest.raises(UserError, match=said):
            Decision.load(tmp_path / "decision.json")


def test_the_next_decisions_stand_one_by_one(tmp_path: Path) -> None:
    made = decision(Selected=CUBE, B=BOWL)
    assert made.horizon == 0
    for each, ahead in zip(made.candidates, ((0.9, 0.5, 0.3), (0.0, 0.0, 0.0)), strict=True):
        assert each.now is not None and each.later is not None
        each.parts = {n: [each.now[n], *(each.later[n] * part / 1.7 for part in ahead)] for n in NAMES}
    assert made.horizon == 2
    axis = plots.when(made).axes[0]
    assert [tick.get_text() for tick in axis.get_xticklabels()] == ["now", "+1", "+2", "after"]
    heights = [bar.get_height() for bar in axis.patches]
    assert sum(heights) == pytest.approx(made.selected.overall)
    made.save(tmp_path / "decision.json")
    assert Decision.load(tmp_path / "decision.json").candidates == made.candidates
    content = made.to_dict()
    content["candidates"][0]["when"]["shape"][0] += 0.1
    (tmp_path / "decision.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match="must add up"):
        Decision.load(tmp_path / "decision.json")
