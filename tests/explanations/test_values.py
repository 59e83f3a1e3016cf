"""Decisions of agents without a map: between named actions, from their component values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.views import plots
from xqmap.explanations.views.page import page

ACTIONS = ["step left", "step up", "step right", "step down"]
PARTS = ("gold", "cliff")
Q = np.array([[1.0, 0.5, 0.9, 0.1], [-2.0, -0.1, -0.3, 0.0]])


def steps(**changes: Any) -> Decision:
    return Decision.from_values(**{"q": Q, "actions": ACTIONS, "components": PARTS, "errors": [0.01, 0.01]} | changes)


def test_the_choice_is_the_highest_sum_and_each_letter_the_best_for_one_component() -> None:
    decision = steps()
    assert [(c.label, c.object) for c in decision.candidates] == [
        ("Selected", "step right"),
        ("A", "step left"),
        ("B", "step down"),
    ]
    assert [thing.object for thing in decision.objects] == ["step right", "step up", "step down", "step left"]
    assert decision.error == pytest.approx(0.01 * 2**0.5)
    assert decision.rdx("Selected", "A") == pytest.approx({"gold": -0.1, "cliff": 1.7})


def test_weights_scale_values_and_masked_actions_are_not_there() -> None:
    assert steps(weights={"cliff": 0.0}).selected.object == "step left"
    assert steps(weights=[1, 0.0]).selected.values == {"gold": 1.0, "cliff": 0.0}
    masked = steps(q=np.where([False, False, True, False], np.nan, Q), mask=[1, 1, 0, 1])
    assert masked.selected.object == "step up"
    assert "step right" not in [thing.object for thing in masked.objects]


def test_tensors_that_need_gradients_are_taken() -> None:
    assert steps(q=torch.tensor(Q, requires_grad=True)).to_dict() == steps().to_dict()


def test_questions_are_answered_without_a_word_of_pixels() -> None:
    decision = steps()
    said = {question: decision.ask(question) for question in (
        "why this one?", "why not left?", "Why not the step up?", "how sure are you?", "why not A?", "who are you?",
        "what do you see?", "what is a Q-value?", "what do the letters mean?", "help", "what if cliff did not count?",
    )}  # fmt: skip
    assert "I chose the step right rather than the step left (A)" in said["why not left?"]
    assert "rather than the step up, because gold" in said["Why not the step up?"]
    assert "the step left (A), the step right" not in said["what do you see?"]
    assert "I would choose the step left (A)" in said["what if cliff did not count?"]
    assert "no place on a map" in decision.ask("where is it?")
    assert [answer for answer in said.values() if "did not understand" in answer or "pixel" in answer] == []
    assert [e.ungrounded for e in decision._talk().exchanges if e.ungrounded] == []


def test_one_action_under_two_letters_is_told_once() -> None:
    decision = steps(
        q=[[0.9, 0.5, 1.0], [0.9, 0.5, 1.0], [0.3, 0.0, -1.5]], actions=ACTIONS[:3], components="xyz", errors=None
    )
    assert [c.object for c in decision.candidates] == ["step left", "step right", "step right", "step left"]
    sure = decision.ask("how sure are you?")
    assert sure.count("step right") == 1
    assert sum("rather than the step right" in line for line in decision.why().splitlines()) == 1
    assert "For z (C) alone I would choose the same, the step left: z agrees with my choice." in decision.why()
    assert decision.why("C").startswith("My choice and candidate (C) are the same, the step left")


def test_one_component_is_told_without_maps() -> None:
    decision = steps(q=Q[:1], components=["reward"], errors=None)
    assert "one value for the whole reward" in decision.why()
    assert "Map" not in decision.why() + decision.ask("which property matters most?") + decision.ask("what is Q?")
    assert "is not known" in decision.ask("how sure are you?")


def test_views_and_files_work_and_maps_say_what_is_missing(tmp_path: Path) -> None:
    decision = steps(task="cliff")
    assert decision.save(tmp_path / "decision.json") == [tmp_path / "decision.json"]
    again = Decision.load(tmp_path / "decision.json")
    assert again.to_dict() == decision.to_dict()
    assert again.why() == decision.why()
    assert "step right" in page([decision])
    assert decision._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="no maps to draw"):
        plots.qmaps(decision)


def test_a_name_is_enough_where_no_other_has_its_words() -> None:
    decision = steps()
    assert decision.why("left") == decision.why("A") == decision.why("step left")
    for unclear in ("step", "jump", ""):
        with pytest.raises(UserError, match=r"nothing here is called .*; there are Selected, A, B, step right"):
            decision.why(unclear)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q": Q.T}, r"q is \[4, 2\], must be \[2, 4\]"),
        ({"q": Q * np.nan}, "q holds NaN"),
        ({"actions": ["a", "a", "b", "c"]}, "actions=.* none twice"),
        ({"components": []}, "components="),
        ({"mask": [0, 0, 0, 0]}, "mask must be 4"),
        ({"mask": [1, 1]}, "mask must be 4"),
        ({"weights": [1.0]}, "weights=.* must be 2"),
        ({"weights": {"silver": 1.0}}, "weights names .*silver"),
        ({"errors": [-1.0, 0.0]}, "errors=.* 0 or more"),
        ({"q": np.zeros((2, 1001)), "actions": [f"go {i}" for i in range(1001)]}, "1001 actions are more than 1000"),
    ],
)
def test_what_does_not_fit_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        steps(**changes)
