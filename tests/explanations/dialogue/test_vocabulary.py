"""The framework knows no colors and no kinds of thing: they come from the decision and from the wording of its task."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import xqmap
from xqmap.explanations import Candidate, Decision
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.dialogue.grounding import ungrounded
from xqmap.explanations.views.sentences import wording_for

ROOT = Path(xqmap.__file__).parent
WORDS = wording_for("plain")
# What is drawn with, whatever the world looks like.
PENS = ("black", "white", "gray")


def named_in(code: str, pens: bool = False) -> list[str]:
    """The strings of a module, docstrings aside, that name a color or a kind of thing; ``pens``: it draws."""
    names = "|".join([*WORDS["other_things"], *WORDS["other_looks"]])
    tree = ast.parse(code)
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs
        # Without the letters of a pattern's signs, like the b of \b.
        if re.search(rf"(?<![^\W_])({names})(e?s)?(?![^\W_])", re.sub(r"\\[a-zA-Z]", " ", node.value), re.IGNORECASE)
        if not (pens and node.value in PENS)
    ]


def test_no_code_names_a_color_or_a_kind_of_thing() -> None:
    found = {
        str(path): named
        for path in ROOT.rglob("*.py")
        # What is measured, and what damaged files are made of, is the worlds that are here.
        if path.relative_to(ROOT).parts[0] != "benchmarks"
        if (named := named_in(path.read_text(), pens=path.parent.name in ("views", "reports")))
    }
    assert not found


def test_the_search_finds_what_it_is_for() -> None:
    code = [
        '"""Red cubes."""',
        'ONE = "the red one"',
        'TWO = ("blue", "hundred")',
        'THREE = r"\\bcubes?\\b|blocked"',
        'FOUR = f"{ONE} pyramids"',
    ]
    assert sorted(named_in("\n".join(code))) == [" pyramids", r"\bcubes?\b|blocked", "blue", "the red one"]
    assert named_in('a.plot(color="white")\nB = ("white", "red")', pens=True) == ["red"]


def sorting() -> Dialogue:
    """About a world that the framework has never heard of."""
    things = {
        "turquoise parcel": (0.9, 0.8),
        "striped parcel": (0.2, 0.9),
        "striped barrel": (0.7, 0.1),
        "conveyor": (0.0, 0.0),
    }
    values = [(name, dict(zip(("size", "label"), pair, strict=True))) for name, pair in things.items()]
    labels = ["Selected", "A", "B"]
    candidates = [
        Candidate(labels[i], name, v, (i, i), None, i) for i, (name, v) in enumerate(values) if i < len(labels)
    ]
    objects = [Candidate(name, name, v, (i, i), None, i) for i, (name, v) in enumerate(values)]
    decision = Decision("sorting", ("size", "label"), candidates, objects=objects, noise={"size": 0.02, "label": 0.02})
    return Dialogue(decision, wording_for("sorting"))


@pytest.mark.parametrize(
    ("question", "kind", "says"),
    [
        ("Why did you take your parcel?", "shallow", "turquoise parcel"),
        ("What is your parcel worth?", "values", "The turquoise parcel has size 0.90"),
        ("Why not the striped barrel?", "contrastive", "striped barrel (B)"),
        ("Why not the barrel?", "contrastive", "striped barrel (B)"),
        ("why not the stripd barel?", "contrastive", "striped barrel (B)"),
        ("Why not the conveyor?", "contrastive", "conveyor"),
        ("Which is the worst parcel?", "most", "the striped parcel (A) with 1.10 comes last"),
        ("How many barrels are there?", "scene", "one striped barrel"),
        ("list the parcels", "scene", "one striped parcel"),
        ("Why not the turquoise barrel?", "missing", "no turquoise barrel"),
        ("Why not the pink parcel?", "missing", "no pink parcel"),
        ("Why not the pink pyramid?", "missing", "no pink pyramid"),
        ("How sure are you about the red cube?", "missing", "no red cube"),
        ("Why not green?", "missing", "no green thing"),
    ],
)
def test_another_world_is_talked_about_in_its_own_words(question: str, kind: str, says: str) -> None:
    exchange = sorting().ask(question)
    assert exchange.kind == kind, exchange
    assert says in exchange.answer, exchange.answer
    assert not exchange.ungrounded


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        ("The turquoise parcel beats the striped barrel.", []),
        ("The turquoise barrel was worse.", ["turquoise barrel"]),
        ("The red pyramid was worse.", ["red pyramid"]),
    ],
)
def test_what_another_world_does_not_hold_is_found(answer: str, found: list[str]) -> None:
    assert ungrounded(answer, sorting().decision) == found


def test_a_task_names_further_things_and_looks_itself() -> None:
    talk = sorting()
    talk.words |= {"other_things": ["drum"], "other_looks": ["teal"]}  # type: ignore[operator]
    assert talk.ask("How good is the dented drum?").answer.startswith("I see no dented drum")
    assert talk.ask("Why not teal?").answer.startswith("I see no teal thing")
    assert talk.ask("Why not green?").kind == "unknown"
