"""The languages that ship: each has words for what intents ask, and its examples are understood and answered in it."""

from __future__ import annotations

import pytest

from tests.explanations.dialogue.test_referring import field
from tests.talks import decision
from xqmap.explanations.dialogue.answers import KINDS
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.dialogue.intents import lines
from xqmap.explanations.dialogue.language import intents, language, languages
from xqmap.explanations.views.sentences import wording_for
from xqmap.explanations.views.words import phrase

# What a question holds beside a language's concepts.
OTHERS = {
    *("own", "thing", "things", "letter", "kind", "claim", "component", "components", "property", "factor", "number"),
    "order",
}


def test_every_intent_has_an_answer_and_every_concept_words() -> None:
    assert set(intents()["intents"]) <= set(KINDS)
    used = {name for line in lines() for name in (*(n for group in line.needs for n in group), *line.may, *line.never)}
    assert used - OTHERS <= language("en").asked
    assert {"en", "de"} <= set(languages())
    for name in languages():
        rare = {"contribute", "lowest", "smallest"}
        assert language("en").asked - language(name).asked <= rare, name


@pytest.mark.parametrize("name", languages())
def test_examples_are_understood(name: str) -> None:
    words = wording_for("landing", "" if name == "en" else name)
    for kind, asked in language(name).content["examples"].items():
        for text in asked:
            exchange = Dialogue(field(), wording_for("landing")).ask(text.format(component=phrase("color", words)))
            assert exchange.kind == kind, exchange
            assert not exchange.ungrounded, exchange


@pytest.mark.parametrize(
    ("question", "kind", "says"),
    [
        ("Warum hast du das gewählt?", "shallow", ["»blauer flacher Block«", "2.00", "Farbe"]),
        ("Warum nicht der rote Block oben links?", "contrastive", ["»roter flacher Block«", "üblichen Fehler"]),
        ("Warum nicht der rote Block?", "which_one", ["drei", "oben links", "unten links"]),
        ("Warum nicht der gelbe Würfel?", "missing", ["sehe ich hier nicht"]),
        ("Was wäre, wenn Farbe doppelt so viel zählte?", "what_if", ["doppelt so viel", "3.0"]),
        ("Welche Blöcke sind flach?", "which", ["drei", "Ebenheit"]),
        ("Wie weit ist B entfernt?", "distance", ["m auseinander"]),
        ("Ist es gefährlich?", "safe", ["kann ich nicht sagen"]),
        ("Ordne alle Blöcke nach Farbe.", "rank", ["Der Reihe nach (Farbe)"]),
        ("Warum nicht B, und wie sicher bist du?", "contrastive + sure", ["Dafür spricht", "zurück"]),
    ],
)
def test_german_is_understood_and_spoken(question: str, kind: str, says: list[str]) -> None:
    exchange = Dialogue(field(), wording_for("landing")).ask(question)
    assert exchange.kind == kind, exchange
    assert all(word in exchange.answer for word in says), exchange.answer
    assert not exchange.ungrounded


def test_one_conversation_may_change_its_language() -> None:
    talk = Dialogue(field(), wording_for("landing"))
    assert "rather than" in talk.ask("Why not B?").answer
    assert "Dafür spricht" in talk.ask("Warum nicht B?").answer
    assert "Wert" in talk.ask("B?").answer or "Dafür" in talk.exchanges[-1].answer
    assert "rather than" in talk.ask("And why not A?").answer


def test_no_sentence_of_a_language_is_missing() -> None:
    english, other = (wording_for("landing", name) for name in ("", "de"))
    # What is the same in both: forms without words.
    same = {"placed", "count"}
    told = {key for key, text in other["answers"].items() if text == english["answers"][key]}
    assert told <= same


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("why not the one on the left", "why not the one on the left"),
        ("why not the grey flat blok", "why not the gray flat block"),
        ("how certian are you", "how certain are you"),
        ("why not the golden palace", "why not the golden palace"),
        ("wich componet matters most", "which component matters most"),
        ("why didnt you", "why did not you"),
    ],
)
def test_only_words_that_nothing_knows_are_mended(typed: str, read: str) -> None:
    english = language("en")
    names = ["red", "gray", "flat", "block", "flatness"]
    assert " ".join(t.word for t in english.mended(english.tokens(typed), names)) == read


def test_words_that_nothing_knows_are_told() -> None:
    talk = Dialogue(decision(), wording_for("landing"))
    assert talk.ask("Why would a cautious pilot choose B?").answer.startswith('I do not know "cautious" and "pilot"')
    assert talk.ask("Colorless ideas sleep furiously").kind == "unknown"
