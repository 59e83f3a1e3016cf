"""Which things a question speaks of: by their names or parts of them, by letter, by place, by what is near, by cell."""

from __future__ import annotations

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.dialogue.mentions import Mention, Pointing, words_of
from xqmap.explanations.dialogue.places import DIRECTIONS

# Words a description may have that nothing knows: "the golden toy cube".
_UNKNOWN = 2
# Things that lie "near" another.
_NEAREST = 3
_PLACES = (*DIRECTIONS, "middle", "corner", "edge")
_BESIDE = {"left_of": "left", "right_of": "right", "above_of": "top", "below_of": "bottom"}


class Referring(Pointing):
    """Finds all mentions of things in a question; see :class:`Pointing`."""

    def mentions(self) -> list[Mention]:
        """All of them, in the order of the question."""
        found: list[Mention] = []
        at = 0
        while at < len(self.tokens):
            mention = self._cell(at) or self._own(at) or self._letter(at) or self._phrase(at) or self._pronoun(at)
            mention = mention or self._around(at)
            if mention is None:
                at += 1
                continue
            if mention.sort == "it" and (earlier := [m for m in found if m.things and m.words[:1] != ["own"]]):
                mention.things = earlier[-1].things[:1]
            found.append(mention)
            at = mention.end
        named = [thing for mention in found if mention.sort == "one" for thing in mention.things]
        for mention in found:
            if mention.sort == "it" and named and all(any(t is other for other in named) for t in mention.things):
                # "Is it better than B?", asked after B.
                mention.things = [self.places.decision.selected]
        return found

    def _phrase(self, start: int) -> Mention | None:
        """A description: "the red block at the top left", "which cubes", "red"."""
        at = start
        definite, some, several, other, chosen = (False,) * 5
        determiners = ("definite", "indefinite", "of_all", "other", "chosen_before")
        while self._is(at, *determiners) or (at > start and self._is_count(at)):
            if self._is_count(at):
                several, at = True, at + 1
                continue
            past = self._past(at, *determiners)
            chosen |= self._is(at, "chosen_before")
            definite |= self._is(at, "definite")
            some |= self._is(at, "indefinite")
            several |= self._is(at, "of_all")
            other |= self._is(at, "other")
            at = past
        determined = at > start
        words: list[str] = []
        strange: list[str] = []
        sides: list[str] = []
        asked: list[int] = []
        first = at
        order, size, best, noun = 0, "", False, None
        ordinals = self.language.content["ordinals"]
        while at < len(self.tokens):
            token = self.tokens[at]
            if not determined and self._property(at):
                # "Is it flat?" asks for a property.
                break
            if (best or (determined and self._is(at, "most"))) and self._property(at):
                best = True
                asked.append(at)
                at += 1
                continue
            if noun := self._stem(at, self.nouns):
                words.append(noun)
                at += 1
                break
            if self._is(at, "generic") and (determined or at > first):
                noun = ""
                at += 1
                break
            if (look := self._stem(at, self.looks)) and not (self._is(at, "is") and not determined):
                words.append(look)
            elif token.word in ordinals and (determined or sides):
                order = int(ordinals[token.word])
            elif side := next((word for word in _PLACES if self._is(at, word)), None):
                sides.append(side)
                size = "farthest" if self._is(at, "farthest") else size
            elif self._is(at, "big", "small", "tall"):
                size = next(word for word in ("big", "small", "tall") if self._is(at, word))
            elif self._is(at, "chosen_before") and determined:
                chosen = True
            elif self._is(at, "most", "least", "better") and determined:
                best = True
            elif token.word in ("-", "/"):
                pass
            elif self._strange(at) and determined and len(strange) < _UNKNOWN:
                strange.append(token.word)
            else:
                break
            at += 1
        # "Not the sky": without a known noun only what ends there is a thing.
        ends = len(strange) == 1 and definite and at == first + 1 and self._ends(at) and not best
        if noun is None and (strange or best) and not words and not ends:
            return None
        if noun is None and not (words or sides or strange or (other and definite)):
            return None
        compared = self._is(at, "than", "better", "worse", "or") or self._is(start - 1 if start else 0, "than", "or")
        if noun is None and not determined and not (words and (self._ends(at) or compared)) and not sides:
            return None
        if best and not words and noun is None:
            return None
        said = " ".join(t.text for t in self.tokens[first:at])
        if noun is None and words:
            said = str(self.language.content["of_look"]).format(look=said)
        if other:
            said = str(self.language.content["of_other"]).format(thing=said)
        mention = Mention(start, at, "one", said=said, words=words)
        mention.head = first
        mention.places, mention.unknown, mention.asked = sides, bool(strange), asked
        plural = noun is not None and at > first and self._is_plural(self.tokens[at - 1].word, noun)
        alone = noun is None and not words and not strange
        pool = self._fitting(words, strange)
        if alone and not definite and not self._is(start - 1 if start else start, "not", "about", "or"):
            mention.sort = "many"
        elif alone and start and self._is(start - 1, "at"):
            # "In the top left corner."
            mention.sort = "many"
        elif (several and not size) or plural or best or (not determined and not words[:-1] and noun):
            mention.sort = "many"
        elif some or not determined:
            mention.sort = "some"
        if mention.sort == "many" and noun == "" and not words and not strange and not sides:
            pool = list(self.places.things)
        known = [c for c in (*self.before, self.places.decision.selected) if any(c is fits for fits in pool)]
        if self._is(start, "demonstrative") and mention.sort == "one" and not sides and known and words:
            # "That block" is what was spoken of.
            pool = known[:1]
        if chosen and not other:
            mention.words, pool = ["own"], [self.places.decision.selected]
        pool = self._after(mention, pool, strange)
        if other:
            pool = [c for c in pool if not any(c is known for known in self._others_than())]
        mention.things = pool if chosen else self._chosen_by(pool, size, order, mention)
        return mention

    def _is_count(self, at: int) -> bool:
        """Whether a number stands before things: "the two cubes"."""
        counts = self.language.content["numbers"][2:]
        return at < len(self.tokens) and (
            self.tokens[at].word in counts or self.tokens[at].word in map(str, range(2, 11))
        )

    def _around(self, at: int) -> Mention | None:
        """What is near something, left of it, …, without a word for it: "what is next to B?"."""
        relation = next((word for word in (*_BESIDE, "between", "near") if self._is(at, word)), None)
        asked = ("differ", "compare", "distance", "better", "choose")
        if relation is None or not at or any(self._is(i, *asked) for i in range(at)):
            return None
        mention = Mention(at, at + 1, "many", head=at)
        found = self._related(mention, list(self.places.objects), relation, at)
        mention.things = found
        return mention if mention.end > at + 1 else None

    def _others_than(self) -> list[Candidate]:
        chosen = self.places.decision.selected
        return [chosen, *[c for c in self.before if c is not chosen]]

    def _fitting(self, words: list[str], strange: list[str]) -> list[Candidate]:
        """The things whose names hold all of the words; without a word, the objects."""
        if strange:
            known = [set(words_of(thing)) for thing in self.places.things]
            return [t for t, name in zip(self.places.things, known, strict=True) if {*words, *strange} <= name]
        if not words:
            return list(self.places.objects)
        stems = self.language.stems
        return [
            thing
            for thing in self.places.things
            if all(any(set(stems(word)) & set(stems(part)) for part in words_of(thing)) for word in words)
        ]

    def _after(self, mention: Mention, pool: list[Candidate], strange: list[str]) -> list[Candidate]:
        """The things that are left by what follows a description: "you chose", "at the top left", "next to B"."""
        while True:
            at = mention.end
            if (past := self._past(at, "chosen")) > at:
                mention.end, mention.words = past, ["own"]
                pool, mention.sort = [self.places.decision.selected], "one"
                continue
            relation = next((word for word in (*_BESIDE, "between", "near") if self._is(at, word)), None)
            lead = at
            linking = ("at", "definite", "is") if mention.sort == "many" else ("at", "definite")
            while relation is None and self._is(lead, *linking) and lead - at < 4:
                lead = max(lead + 1, self._past(lead, "at"))
                relation = next((word for word in (*_BESIDE, "between", "near") if self._is(lead, word)), None)
            if relation and (nearer := self._related(mention, pool, relation, lead)):
                pool = nearer
                continue
            end, sides, looks = self._side(at, mention.sort == "many")
            if sides or looks:
                mention.end = end
                mention.places += sides
                mention.words += looks
                fitting = self._fitting(mention.words, strange) if looks else pool
                pool = [c for c in pool if c in fitting]
                mention.said = " ".join(t.text for t in self.tokens[mention.head : end])
                continue
            return pool

    def _related(self, mention: Mention, pool: list[Candidate], relation: str, at: int) -> list[Candidate]:
        start, nearest = self._past(at, relation), self._is(at, "nearest")
        one = self._anchor(start)
        if one is None:
            return []
        places, anchor, end = self.places, one.things[0], one.end
        apart = [c for c in pool if c is not anchor]
        if relation == "between":
            other = self._anchor(end + 1)
            if other is None:
                return []
            end = other.end
            ranked = sorted(
                (c for c in apart if c is not other.things[0]), key=lambda c: places.between(c, anchor, other.things[0])
            )
            found = [c for c in ranked if places.between(c, anchor, other.things[0]) < float("inf")]
        elif relation == "near":
            found = sorted(apart, key=lambda c: places.apart(c, anchor))
        else:
            side = _BESIDE[relation]
            beyond = [c for c in apart if places.beside(c, anchor, side) > 0]
            straight = [c for c in beyond if 2 * places.beside(c, anchor, side) ** 2 >= places.apart(c, anchor) ** 2]
            found = sorted(straight or beyond, key=lambda c: places.apart(c, anchor))
        mention.end = end
        mention.said = " ".join(t.text for t in self.tokens[mention.head : end])
        if not found:
            mention.unknown = True
            return []
        if relation == "near":
            found = found[:_NEAREST]
        return found if mention.sort == "many" and not nearest else found[:1]

    def _anchor(self, at: int) -> Mention | None:
        if at >= len(self.tokens):
            return None
        found = self._own(at) or self._letter(at) or self._phrase(at) or self._pronoun(at)
        return found if found is not None and found.things else None

    def _side(self, at: int, many: bool) -> tuple[int, list[str], list[str]]:
        """Place words after a description, and looks ("that is red", "which cubes are red"), and where they end."""
        sides: list[str] = []
        looks: list[str] = []
        end = here = at
        linked = False
        while here < len(self.tokens) and (here == at or here - end < 5):
            if word := next((word for word in _PLACES if self._is(here, word)), None):
                sides.append(word)
                here += 1
                end = here
            elif (look := self._stem(here, self.looks)) and linked and not self._property(here):
                looks.append(look)
                here += 1
                end = here
            elif self._is(here, "at", "definite", "picture") or (many and self._is(here, "is")):
                linked |= self._is(here, "linking", "is")
                past = max(here + 1, self._past(here, "at", "definite", "picture"))
                end = past if self._is(here, "picture") and sides else end
                here = past
            elif self.tokens[here].word in ("-", ",") and sides:
                here += 1
            else:
                break
        return end, sides, looks

    def _chosen_by(self, pool: list[Candidate], size: str, order: int, mention: Mention) -> list[Candidate]:
        """Of fitting things those at the place, of the size or at the rank that is named."""
        sides = mention.places
        if not pool:
            return pool
        directions = [word for word in sides if word in DIRECTIONS]
        if directions and order:
            ranked = self.places.farthest(pool, directions)
            return ranked[order - 1 : order] if order > 0 else ranked[order:]
        if sides and size == "farthest" and directions:
            return self.places.farthest(pool, directions)[:1]
        if sides:
            there = [c for c in pool if self.places.lies(c, sides)]
            # "The left one" of two that lie in the middle: what is left of it.
            pool = there or [c for c in pool if len(pool) > 1 and self.places.lies(c, [*sides, "half"])]
        if size in ("big", "small"):
            known = [c for c in pool if self.places.cells(c)]
            pool = sorted(known, key=lambda c: (self.places.cells(c) or 0) * (-1 if size == "big" else 1))[:1] or pool
        if size == "tall":
            known = [c for c in pool if self.places.height(c) is not None]
            pool = sorted(known, key=lambda c: -(self.places.height(c) or 0.0))[:1] or pool
        if order:
            ranked = sorted(pool, key=lambda c: -c.overall)
            return ranked[order - 1 : order] if order > 0 else ranked[order:]
        return pool
