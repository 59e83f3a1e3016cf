"""Understands a question about a decision well enough to answer it from the numbers: what is asked, and about whom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.factors import factor_in, factors_in
from xqmap.explanations.dialogue.followups import again, answered, distinct, goes_on
from xqmap.explanations.dialogue.intents import choose
from xqmap.explanations.dialogue.language import Language, Span, Token, intents
from xqmap.explanations.dialogue.mentions import Mention, is_own, separately, words_of
from xqmap.explanations.dialogue.places import Places
from xqmap.explanations.dialogue.question import ABOUT_ALL, Question
from xqmap.explanations.dialogue.referring import Referring

# Words of a question like "the red one?", which goes on with the one before.
_SHORT = 5
_BARE = {"thing", "things", "opposite", "own", "letter", "kind", "claim", "component", "factor"}
# After these, another than the chosen one is meant.
_TURNS = ("not", "than", "instead", "compare", "differ", "against", "wrong", "other")
# These are asked of two things.
_BETWEEN = ("differ", "compare", "distance")
# Concepts that words within a mention keep.
_KEPT = ("which", "what", "how_many", "all", "most", "least", "not", "exists")
# Kinds that are about the choice where nothing is named.
_OF_CHOICE = ("shallow", "sure", "robust", "chance", "component", "runner_up", "safe")


class Understanding:
    """Reads questions about one decision in one language.

    Args:
        decision: what they are about.
        words: the task's wording, for what components are called and what else there may be.
        language: of the questions.
    """

    def __init__(self, decision: Decision, words: Mapping[str, Any], language: Language) -> None:
        self.decision, self.words, self.language = decision, words, language
        self.places = Places(decision)
        self._components = {
            name: [name, str(words["components"].get(name, name)), *words["synonyms"].get(name, [])]
            for name in decision.components
        }
        known = {
            word.lower()
            for name, called in self._components.items()
            for word in (*called, *words["opposites"].get(name, []))
        }
        self._properties = {
            name: [word for word in called if word.lower() not in known]
            for name, called in (
                *(
                    (name, [name, *words["synonyms"].get(name, [])])
                    for name in (*words["components"], *words["other_properties"])
                ),
                *language.content["properties"].items(),
            )
            if name.lower() not in known
        }
        self._known_words = [*known, *self._properties]

    @property
    def _names(self) -> list[str]:
        things = [word for thing in self.places.things for word in words_of(thing)]
        ends = self.language.content["degrees"].values()
        degrees = [form for word in self._known_words for end in ends for form in _degrees(word, end)]
        return [*things, *self.words["other_things"], *self.words["other_looks"], *self._known_words, *degrees]

    def knows(self, text: str) -> int:
        """How many words of a text are of this language."""
        words = [token.word for token in self.language.tokens(text) if token.is_word]
        return sum(self._known(word) for word in words)

    def read(self, text: str, before: Question | None = None) -> list[Question]:
        """The questions in a text; one that refers back ("and B?", "where is it?") goes on with ``before``."""
        found: list[Question] = []
        for part in self._parts(self.language.mended(self.language.tokens(text), self._names)):
            found.append(self._read(part, before))
            before = found[-1] if found[-1].kind not in ("help", "unknown", "thanks") else before
        clear = [question for question in found if question.kind not in ("help", "unknown", "thanks")]
        return clear or found[:1] or [self._read([], before)]

    def _parts(self, tokens: list[Token]) -> list[list[Token]]:
        """Several questions in one text."""
        parts: list[list[Token]] = [[]]
        asks, joins = self.language.content["asks"], self.language.content["clauses"]
        for i, token in enumerate(tokens):
            after = tokens[i + 1].word if i + 1 < len(tokens) else ""
            if token.word in "?!.;" or (token.word in joins and len(parts[-1]) > 1 and after in asks):
                if token.word not in joins:
                    parts[-1].append(token)
                parts.append([])
            else:
                parts[-1].append(token)
        return [part for part in parts if any(token.is_word or token.number is not None for token in part)]

    def _read(self, tokens: list[Token], before: Question | None) -> Question:
        spans = self.language.concepts(tokens) + self._properties_in(tokens)
        subject = before.subject if before is not None else []
        if any(span.concept == "rank" and span.start == 0 for span in spans):
            # "Rank" at the beginning asks for an order, also where a component is called so.
            spans = [span for span in spans if span.start > 0 or ":" not in span.concept]
        pool = before.pool or [] if before is not None else []
        mentions = Referring(tokens, spans, self.places, self.language, self.words, subject, pool).mentions()
        if any(span.concept in _BETWEEN for span in spans):
            mentions = [one for mention in mentions for one in separately(mention)]
        inside = {at: mention for mention in mentions for at in range(mention.start, mention.end)}
        free = [s for s in spans if s.concept in _KEPT or not all(at in inside for at in range(s.start, s.end))]
        free += [s for s in spans if s.start in inside and s.start in inside[s.start].asked and s.concept not in _KEPT]
        named = {s.start: s.concept.partition(":")[2] for s in free if s.concept.startswith("component:")}
        factors = factors_in(tokens, named, self.decision.components, self.language)
        bag = self._bag(free, mentions, named, bool(factors) or factor_in(tokens, self.language) is not None, tokens)
        strange = [
            t.text
            for i, t in enumerate(tokens)
            if t.is_word
            and i not in inside
            and not any(s.start <= i < s.end for s in spans)
            and not self._known(t.word)
        ]
        kind, explained = choose(bag)
        if len(strange) > explained or (strange and not mentions and kind == "contrastive"):
            kind = "unknown"
        question = Question(kind, strange=strange)
        question.component = next(iter(named.values()), None)
        question.factors = factors
        return self._settled(question, mentions, bag, tokens, before, free)

    def _known(self, word: str) -> bool:
        return len(word) < 2 or self.language.knows(word) or self.language.stem(word, set(self._names)) is not None

    def _properties_in(self, tokens: Sequence[Token]) -> list[Span]:
        """Components and other properties, in any degree ("flattest"), by their opposites too."""
        found = []
        opposite = {name: self.words["opposites"].get(name, []) for name in self._components}
        for sort, lists in (("component", self._components), ("component", opposite), ("property", self._properties)):
            for name, called in lists.items():
                for word in called:
                    typed = word.lower().rstrip("*").split()
                    for i in range(len(tokens) - len(typed) + 1):
                        here = [token.word for token in tokens[i : i + len(typed)]]
                        degree = self._degree(here[0], typed[0]) if len(typed) == 1 else None
                        if here == typed or degree or (word.endswith("*") and here[0].startswith(typed[0])):
                            concepts = [f"{sort}:{name}", *([degree] if degree else [])]
                            concepts += ["opposite"] if lists is opposite else []
                            found += [Span(concept, i, i + len(typed)) for concept in concepts]
        return found

    def _degree(self, typed: str, word: str) -> str | None:
        """Whether a typed word is more, or most, of another."""
        for concept, ending in self.language.content["degrees"].items():
            if typed in _degrees(word, ending):
                return str(concept)
        return None

    def _bag(
        self, free: list[Span], mentions: list[Mention], named: dict[int, str], factor: bool, tokens: list[Token]
    ) -> dict[str, float]:
        """The concepts of a question, and how many of its words stand for each."""
        bag: dict[str, float] = {}
        for span in free:
            name = span.concept.partition(":")[0]
            if name not in self.language.asked and name not in ("component", "property", "opposite"):
                continue
            bag[name] = max(bag.get(name, 0.0), float(span.end - span.start))
        others = [m for m in mentions if m.sort in ("one", "it") and not _all_own(m)]
        bag |= {"own": 1.0} if any(m.sort in ("one", "it") and _all_own(m) for m in mentions) else {}
        bag |= {"thing": 1.0} if others else {}
        told = [c for m in others if m.sort == "it" or len(m.things) == 1 for c in m.things if not is_own(c)]
        unclear = sum(m.sort == "one" and len(m.things) != 1 for m in others)
        bag |= {"things": 2.0} if len(distinct(told)) + unclear > 1 else {}
        bag |= {"order": 1.0} if any(t.word in self.language.content["ordinals"] for t in tokens) else {}
        bag |= {"letter": 1.0} if any(m.letter for m in mentions) else {}
        bag |= {"kind": 1.0} if any(m.sort == "many" for m in mentions) else {}
        bag |= {"claim": 1.0} if any(m.sort == "some" for m in mentions) else {}
        bag |= {"components": 2.0} if len(set(named.values())) > 1 else {}
        bag |= {"factor": 1.0} if factor else {}
        if any(t.number is not None and ("." in t.word or "," in t.word) for t in tokens) and "if" not in bag:
            bag["number"] = 2.0
        return bag

    def _settled(
        self,
        question: Question,
        mentions: list[Mention],
        bag: dict[str, float],
        tokens: list[Token],
        before: Question | None,
        free: list[Span],
    ) -> Question:
        """The question with everything it is about, or what stands in the way of that."""
        kind, words = question.kind, [t for t in tokens if t.is_word or t.number is not None]
        supposed = "if" in bag or "without" in bag
        turn = min((s.start for s in free if s.concept in _TURNS), default=len(tokens))
        strange = next((s.concept.partition(":")[2] for s in free if s.concept.startswith("property:")), None)
        gone = next((m for m in mentions if not m.things and (m.said or m.unknown)), None)
        if gone is not None and not supposed and kind not in ("identity", "disagree"):
            return self._absent(gone, question)
        if strange and question.component is None and kind in intents()["strange"]:
            return replace(question, kind="no_component", component=strange)
        question.property = strange or "" if kind in ("contrastive", "shallow", "pair") else ""
        settled = [self._meant(m, m.start > turn, "why" in bag or "choose" in bag) for m in mentions]
        about = distinct(
            [c for found in settled for c in found if len(found) == 1 or mentions[settled.index(found)].sort == "it"]
        )
        several = next((m for m, f in zip(mentions, settled, strict=True) if m.sort == "one" and len(f) > 1), None)
        groups = [m for m in mentions if m.sort in ("many", "some")]
        # Of "purple rather than yellow" the others; of "not green, it is blue" what is said at last.
        apart = [m for m in groups if not any(map(is_own, m.things))] if "than" in bag else groups[-1:]
        group = next(iter((apart or groups) if kind in ("contrastive", "disagree") else groups), None)
        question.pool = group.things if group else None
        question.said, question.places = (group.said, group.places) if group else ("", [])
        question.claim = group.words if group and group.sort == "some" else []
        opposite = "opposite" in bag
        up, down = {"most", "tallest", "largest"}, {"least", "lowest", "smallest"}
        question.most = not opposite if up & set(bag) else opposite if down & set(bag) else None
        question.denied = ("not" in bag) != opposite
        question.by = (
            "height" if {"tallest", "lowest"} & set(bag) else "size" if {"largest", "smallest"} & set(bag) else ""
        )
        left_open = before is not None and before.kind == "which_one" and len(words) <= _SHORT + 2
        if before is not None and left_open:
            closed = answered(before, mentions, about, tokens, self.places, self.language)
            if closed is not None:
                return closed
        if several is not None and not supposed:
            options = settled[mentions.index(several)]
            open_ = replace(question, about=about)
            return Question("which_one", options, said=several.said, again=open_, subject=options)
        others = [c for c in about if not is_own(c)]
        if kind == "presupposed" and not any(map(is_own, question.pool or [])):
            kind = question.kind = "contrastive"
        if kind in ("robust", "turn", "sure", "chance") and not others and question.pool:
            others = sorted((c for c in question.pool if not is_own(c)), key=lambda c: -c.overall)[:1]
        if kind == "pair" and len(others) < 2:
            kind = question.kind = "contrastive"
        if kind == "runner_up" and question.pool and "if" in bag:
            about = [*about, *question.pool]
        if kind == "number":
            number = next(t.word for t in tokens if t.number is not None and ("." in t.word or "," in t.word))
            question.thing = number.replace(",", ".").lstrip("+-")
        if kind == "what_if" and not question.factors:
            question.kind = "scene_if"
        more = bool(tokens) and goes_on(tokens, self.language)
        bare = len(words) <= _SHORT and set(bag) <= _BARE
        if before is not None and not supposed | ("why" in bag) and (more or bare):
            repeated = again(before, others, about, question, tokens, self.language)
            if repeated is not None:
                return repeated
        if kind == "shallow" and set(bag) <= {"why"} and before is not None and before.subject:
            about = before.subject
            if others := [c for c in about if not is_own(c)]:
                question.kind = "because" if before.kind in ("contrastive", "because") else "contrastive"
        if kind == "unknown" and (about or question.component) and not question.strange:
            question.kind = "component_of" if question.component else "contrastive"
        if kind == "contrastive" and not others and any(not is_own(c) for c in question.pool or []):
            about = []
        if kind == "runner_up" and before is not None and before.kind == kind and goes_on(tokens, self.language):
            about = distinct([*before.about, *about])
        question.about = about if question.kind in ABOUT_ALL else others
        if question.kind == "contrastive" and not others and about:
            question.about = about
        if question.kind in ABOUT_ALL and not about:
            question.about = [self.decision.selected] if question.pool is None else []
        chosen = [self.decision.selected] if question.kind in _OF_CHOICE else []
        question.subject = question.about or about or chosen or (before.subject if before else [])
        return question

    def _absent(self, mention: Mention, question: Question) -> Question:
        if mention.places or not mention.said:
            there = Referring([], [], self.places, self.language, self.words, [])._fitting(mention.words, [])
            if there and mention.words:
                return Question("misplaced", there, thing=mention.said, subject=there[:1])
        return Question("missing", thing=mention.said, by="letter" if mention.letter else "")

    def _meant(self, mention: Mention, turned: bool, choosing: bool) -> list[Candidate]:
        """Of several things that a description fits: the chosen one, or the others, where the question tells."""
        if len(mention.things) < 2 or mention.sort != "one":
            return mention.things
        others = [c for c in mention.things if not is_own(c)]
        if len(others) < len(mention.things):
            return others if turned else [self.decision.selected] if choosing else mention.things
        return mention.things


def _all_own(mention: Mention) -> bool:
    return bool(mention.things) and all(is_own(c) for c in mention.things)


def _degrees(word: str, ending: str) -> tuple[str, str]:
    """How an adjective may be written with an ending: "steeper", "flatter"."""
    return word + ending, word + word[-1] + ending
