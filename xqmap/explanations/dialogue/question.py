"""What a question asks: its kind, and whom and what it is about."""

from __future__ import annotations

from dataclasses import dataclass, field

from xqmap.explanations.candidate import Candidate

# Kinds whose answer is about the chosen thing as well as about others, where it is named.
ABOUT_ALL = ("runner_up component_of values where distance height size identity difference safe next disagree").split()


@dataclass
class Question:
    """What was understood.

    Attributes:
        kind: an intent (``conf/explain/language/intents.yaml``), or ``missing`` (of a thing that is not there),
            ``no_component`` (of a property without a Q-Map of its own), ``which_one`` (of several things that fit) or
            ``unknown``.
        about: the candidates or objects that are named.
        component: the component that is named, if any.
        factors: for ``what_if``, how many times as much a component counts, by name.
        thing: what is missing; for ``number`` the number.
        pool: the things that are spoken of together ("the cubes"); None where none are.
        said: how the question calls them.
        most: whether the most of something is asked for, or the least; None where neither is.
        denied: whether it is asked for what is not so.
        by: ``height`` or ``size`` where things are put in their order.
        strange: words that nothing knows.
        property: a property beside it that no component is.
        subject: whom "it" means afterwards.
        again: for ``which_one``, what is asked about the one that is meant.
    """

    kind: str
    about: list[Candidate] = field(default_factory=list)
    component: str | None = None
    factors: dict[str, float] = field(default_factory=dict)
    thing: str = ""
    pool: list[Candidate] | None = None
    said: str = ""
    most: bool | None = None
    denied: bool = False
    by: str = ""
    strange: list[str] = field(default_factory=list)
    property: str = ""
    subject: list[Candidate] = field(default_factory=list)
    again: Question | None = None
    claim: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
