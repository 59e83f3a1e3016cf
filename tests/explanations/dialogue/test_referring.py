"""Which thing is meant: by its look, its place, what is near, its letter, its cell, and what was spoken of before."""

from __future__ import annotations

import numpy as np
import pytest

from xqmap.explanations import Candidate, Decision
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.scene import Scene
from xqmap.explanations.views.sentences import wording_for

# Name, flatness, color, first row and column (from the lower left), side.
BLOCKS = [
    ("blue flat block", 1.00, 1.00, 30, 16, 4),
    ("red flat block", 0.99, 0.99, 34, 2, 4),
    ("red inclined block", 0.05, 1.02, 18, 35, 4),
    ("red inclined block", 0.03, 0.97, 2, 3, 4),
    ("gray flat block", 0.98, 0.05, 3, 18, 6),
    ("green inclined block", 0.10, 0.95, 17, 17, 3),
]


def field() -> Decision:
    """Six blocks on 40 × 40 cells of 0.5 m, up to 2 m high."""
    cells = np.full((40, 40), -1)
    maps, height = np.zeros((2, 40, 40)), np.zeros((40, 40))
    maps[0] = 1.0
    for i, (_, flatness, color, row, column, side) in enumerate(BLOCKS):
        inside = (slice(row, row + side), slice(column, column + side))
        cells[inside], maps[0][inside], maps[1][inside], height[inside] = i, flatness, color, 0.5 * (i % 4 + 1)
    scene = Scene([name for name, *_ in BLOCKS], cells, "ground", [[0, 20], [0, 20], [0, 3]], height)
    made = Decision(
        "landing", ("flatness", "color"), [], noise=dict.fromkeys(("flatness", "color"), 0.03), maps=maps, scene=scene
    )
    middles = [(row + side // 2, column + side // 2) for *_, row, column, side in BLOCKS]
    made.objects = [made.at(pixel, BLOCKS[i][0]) for i, pixel in enumerate(middles)] + [made.at((10, 10), "ground")]
    made.objects.sort(key=lambda thing: -thing.overall)
    made.candidates = [made.at(middles[0], "Selected"), made.at((10, 10), "A"), made.at(middles[2], "B")]
    return made


def talk() -> Dialogue:
    return Dialogue(field(), wording_for("landing"))


@pytest.mark.parametrize(
    ("question", "kind", "says"),
    [
        # A place decides between namesakes; a gap within the error is a toss-up, and no rejection.
        ("and the red block at the top left?", "contrastive", ["red flat block", "0.02", "toss-up"]),
        ("Why not the red block on the right?", "contrastive", ["red inclined block (B)", "+0.95"]),
        (
            "why not the red one in the bottom left corner?",
            "contrastive",
            ["than the red inclined block at the bottom left"],
        ),
        ("Why not the red block?", "which_one", ["three that fit", "top left", "right", "bottom left", "Which one"]),
        ("Why not the red inclined block?", "which_one", ["two that fit"]),
        ("Why not the gray block at the top?", "misplaced", ["I see no gray block at the top", "at the bottom"]),
        ("Why not the yellow block?", "missing", ["no yellow block", "I see six objects"]),
        ("why not the leftmost block?", "contrastive", ["red flat block"]),
        ("why not the block nearest to B?", "contrastive", ["green inclined block"]),
        ("why not the block between the gray block and your choice?", "contrastive", ["green inclined block"]),
        ("Why not the block below your choice?", "contrastive", ["green inclined block"]),
        ("Why not row 5, column 20?", "contrastive", ["gray flat block"]),
        ("What is at (5, 20)?", "identity", ["gray flat block at the bottom", "flatness 0.98"]),
        ("Why not row 90, column 20?", "missing", ["row 90"]),
        ("What is in the bottom left corner?", "scene", ["one red inclined block"]),
        ("What is near B?", "scene", ["green inclined block"]),
        ("Where are the red blocks?", "where", ["top left", "(B) at the right edge", "bottom left"]),
        ("Is there a yellow block?", "missing", ["no yellow block"]),
        ("Which is the biggest block?", "identity", ["gray flat block"]),
        ("Which block is the tallest?", "most", ["In height (m)", "comes first"]),
        ("How tall is the gray block?", "height", ["0.50 m above"]),
        ("How big is the gray block?", "size", ["about 9.00 m²"]),
        ("How far is B from the gray block?", "distance", ["10.63 m apart"]),
        ("Why didn't you choose a flat block?", "presupposed", ["I did", "blue flat block"]),
        ("Why not a red block?", "contrastive", ["Of the three, the best is the red flat block"]),
        ("You're wrong, that is a red block.", "disagree", ["I cannot check it", "blue flat block, no red block"]),
        ("Is it a red block?", "identity", ["No, that is no red block", "blue flat block"]),
        ("How many blocks are not flat?", "which", ["Of six, three", "at most 0.50"]),
        ("How many are inclined?", "which", ["three", "at most 0.50"]),
        ("What is the steepest block?", "most", ["red inclined block at the bottom left with 0.03 comes last"]),
        ("Rank all blocks by color.", "rank", ["In order of color: the red inclined block (B) (1.02), the blue flat"]),
        ("What is the difference in color between A and B?", "difference", ["-1.02"]),
        ("Is the gray block flatter than B?", "difference", ["0.98", "0.05"]),
        ("At which weight of color would you switch?", "turn", ["counted more than", "red inclined block"]),
        (
            "At what weight of flatness would you choose B?",
            "turn",
            ["block (B) would be just as good"],
        ),
        ("Why is flatness above 1?", "above", ["at most 1", "1600 cells"]),
        ("Is it safe?", "safe", ["no property of that kind", "flatness 1.00 and color 1.00"]),
        ("Will it hold?", "safe", ["cannot say"]),
        ("What happens next?", "next", ["2.00"]),
        ("What would come after B?", "next", ["red inclined block (B)"]),
        ("Why this one, and how sure are you?", "shallow + sure", ["highest", "behind"]),
        ("Show me the picture.", "show", ["The picture shows"]),
        ("What if B were gone?", "runner_up", ["I would still choose"]),
        ("What if the blue block were gone?", "runner_up", ["next best thing is the red flat block"]),
    ],
)
def test_the_thing_that_is_meant_is_spoken_of(question: str, kind: str, says: list[str]) -> None:
    exchange = talk().ask(question)
    assert exchange.kind == kind, exchange
    assert all(word in exchange.answer for word in says), exchange.answer
    assert not exchange.ungrounded, exchange


def test_what_was_left_open_is_answered_by_a_word() -> None:
    made = talk()
    for reply in ("the one at the bottom left", "the third one", "the last"):
        assert made.ask("How tall is the red block?").kind == "which_one"
        exchange = made.ask(reply)
        assert exchange.kind == "height", exchange
        assert "m above" in exchange.answer and "red inclined block" in exchange.answer


def test_follow_ups_keep_their_subject() -> None:
    made = talk()
    assert made.ask("Why not A?").kind == "contrastive"
    assert "red inclined block (B)" in made.ask("and B?").answer
    assert made.ask("why?").kind == "because"
    assert "flatness 1.00 of the blue flat block and 0.05 of the red inclined block (B)" in made.exchanges[-1].answer
    assert "red inclined block (B) lies at the right edge" in made.ask("where is it?").answer
    assert "for the red inclined block (B)" in made.ask("how flat is it?").answer
    assert "Of three, one" in made.ask("How many red blocks are there and which of them are flat?").answer


def test_a_picture_that_is_asked_for_is_drawn(tmp_path) -> None:  # type: ignore[no-untyped-def]
    decision = field()
    decision.heightmap = np.zeros((4, 40, 40), np.float32)
    exchange = Dialogue(decision, wording_for("landing"), folder=tmp_path).ask("plot that")
    assert exchange.picture == str(tmp_path / "qmaps.png") and exchange.picture in exchange.answer
    assert (tmp_path / "qmaps.png").stat().st_size > 1000


def test_directions_are_those_of_the_picture() -> None:
    """Rows grow upwards, as the maps are drawn."""
    where = talk().ask("Where is B?").answer
    assert "row 20, column 37" in where and "at the right edge" in where
    assert "at the top" in talk().ask("Where is your choice?").answer


def test_candidates_are_things_once() -> None:
    made = Decision("landing", ("flatness",), [Candidate("Selected", "ground", {"flatness": 1.0}, (0, 0))])
    assert Dialogue(made, wording_for("landing")).ask("Why not the ground?").answer.startswith("That is the ground")
