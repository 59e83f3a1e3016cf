"""Understands a question about a decision well enough to answer it from the numbers: what is asked, and about whom."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.decision import Decision
from xqmap.explanations.dialogue.factors import components_in, factor_in, factors_in
from xqmap.explanations.dialogue.naming import Vocabulary, missing, named, plain, respelled

# How each kind of question is recognised, in the order in which they are tried; <things> are the vocabulary's nouns.
ASKS = {
    "self": r"\b(who|what) are you\b(?! (going|best))|\bwho made you\b|what are you doing|going on"
    r"|how (were|did|do) you (trained|learn\w*|made|work)\b|\bneural\b|\bnetworks?\b|\bllm\b|\bgpt\b|language model"
    r"|\ban? (ai|robot|human|bot)\b|your (job|task)\b",
    "help": r"^(help|hello|hi|hey)\b|^$|what (can|could|may|should) (i|you)\b|what do you know|what do you mean\b",
    "thanks": r"^(many )?(thanks|thank you)\b(?!.*\b(why|what|how)\b)"
    r"|^(ok|okay|great|good|nice|cool|i see|got it|bye)$",
    "what_if": r"\b(what|how) if\b|\bif\b|\bsuppose\b|\bimagine\b|\bassum|\bwithout\b|\bignor"
    r"|\bwhat about .*\b(twice|half|times)\b",
    "number": r"\b(what|which|where|why)\b.*\d[.,]\d|^[+-]?\d+[.,]\d+$",
    "robust": r"\bflip|change your (mind|choice)|what would it take|\brobust|how close|turn the (choice|decision)"
    r"|\bnarrow\b|\btight\b|(have|need|has) to (be|drop|change|fall|sink|shrink|rise|grow)\b"
    r"|before you (would )?(change|choose|pick)|\bwhen would you\b|\bmake you (choose|pick|take|change)\b",
    "chance": r"\bprobab|\bchances?\b|\blikely\b|\b(it|that|this) work\b|\bsucceed",
    "sure": r"\b(un)?sure\b|\bcertain|\bconfiden|\btrust\b|\breliab|\bdoubt|toss-?up|\bnoise\b|\berrors?\b"
    r"|\bclear (choice|winner|call)|\bclose call\b|\bhow far (ahead|behind|apart)\b|\bby how much\b"
    r"|\bhow much better\b|\bmargin\b|\bmistaken?\b|\byou (be )?wrong\b",
    "rdx": r"\b(rdx|msx)\b",
    "q_value": r"\bq-?\s?(values?|maps?)\b|\boverall value\b.*\bmean"
    r"|what('?s| is| does) (the|an|this) (overall value|sum|total|reward)\b"
    r"|\bwhat('?s| is| are| does)( an?| the| your)?( \w+)? (components?|propert(y|ies)|decomposition)\b"
    r"(?!.*\b(most|main|you|your|best)\b)"
    r"|\bhow many (components|properties)|\bcombine\b|\bsum them\b|\badd (them|up)",
    "where": r"\bwhere\b|\bposition\b|\bcoordinates?\b|\blocation\b",
    "who": r"^(what|who|which)('?s| is| does)? (the )?(candidate |pixel |option |letter |point |spot )?"
    r"\w{1,2}( mean| stand for| here)?$"
    r"|^tell me about (candidate |pixel |option )?\w{1,2}$",
    "meaning": r"\bmeans?\b|\bmeaning\b|\bdefin|stands? for|\bmeasure|what('?s| is| are) (a |an |the )?[\w-]+\??$",
    "runner_up": r"second[- ]best|runner|next best|something else|anything else|anywhere else|somewhere else"
    r"|another (one|place|spot)|\bpick next\b|\bcomes? (next|after)\b|\b(any|some)thing better\b|\bthere a better\b",
    "most": r"\bworst\b|\b(lowest|least|highest|best|largest|most|top)\b|^(rank|order|sort) "
    r"|^which \w+ (is|are|has|have)\b",
    "component": r"\b(which|what)\b.*(component|propert|contribut|factor|matter|mostly|most\b|feature|criteri)"
    r"|main reason|most important",
    "contrastive": r"\bwhy\b.*\b(not|no|rather|instead|over|than|better)\b"
    r"|\bwhy (did|do|have|are|was|is|could|would)n.?t\b|\bcompare|\bversus\b|\bvs\b|\bdifferen"
    r"|\b(better|worse|best) (than|of)\b|\bwrong with\b|\bagainst\b|\binstead of\b"
    r"|\b(which|who|what)\b.* is (better|worse)\b",
    "list": r"\b(what|which|who|list|show|name|how many)\b.*"
    r"\b(candidates?|options?|alternatives?|choices|letters?|star)\b|what else",
    "scene": r"^any\b|^(?!.*\bbest\b).*(what (do|can|did) you see|what('s| is| are) (there|in|on)\b"
    r"|\b(is|are) there\b|\bdo you see\b|\bhow many\b.*\b(objects?|things?|(<things>)s?|there|ones)\b"
    r"|\b(what|which|list|name|show)( me)?( all)?( the)? (objects?|things?|(<things>)s?|scene)\b)",
    "component_of": r"\bhow\b|\bwhat\b|\bvalue\b|\brole\b|^(is|was|does|did|are)\b|\bscore|\btell me\b|\bmuch\b"
    r"|\bwhy (is|was)\b.*\b(high|low|negative|positive|zero|small|large)\b",
    "values": r"\bvalues?\b|\bhow good\b|\bscore|\bworth\b|\bnumbers?\b|\btell me about\b|\bwhat is\b|\bhow much\b",
    "shallow": r"\bwhy\b|\bexplain|\breasons?\b|\bwhat made\b|\bhow come\b"
    r"|what (did|do|will|have) you (choose|chosen|pick|select)|\bwhat is selected\b|\bjustify\b"
    r"|which (one|object)? ?did you|\bwhat was your (choice|decision)\b|\bhow did you decide\b|\bbest\b",
}
# Words that are mended where they are misspelled, besides those of the scene and its components.
_VOCABULARY = (
    "which difference different compare component property value values matter matters important certain counted "
    "twice better instead rather object"
)
_SUPPOSED = r"\bif\b|\bsuppose\b|\bimagine\b|\bassum|\bwithout\b"
# Of the chosen one: that it could not be chosen.
_GONE = (
    r"\b(no|gone|remov\w*|missing|taken|vanish\w*|blocked|disappear\w*|without|not there)\b"
    r"|\bcan('?t|not| not)\b|\bcould(n'?t| not)\b|n't there\b"
)
# What is put in order ...
_RANKED = r"\bworst\b|\b(<things>|object|thing|option|candidate|spot|one)s?\b"
# ... and what asks for a reason, not for an order.
_NOT_RANKED = (
    r"\bwhy\b|important|matter|contribut|reason|factor|propert|component|criteri|differen|\bspeaks?\b"
    r"|\bmostly\b|\bat (most|least)\b"
)
# In "why not the …", words that mean whatever was next best.
_ANYTHING = r"objects?|things?|others?|rest|ones?|one|then|now|any"
# Words of a question like "the red one?", which goes on with the one before.
_SHORT = 5
# Kinds that "and B?" can repeat for somebody else.
_REPEATED = "who contrastive what_if component component_of sure robust values where meaning".split()


@dataclass
class Question:
    """What was understood.

    Attributes:
        kind: a key of ``ASKS``, ``pair`` (two candidates of which neither was chosen), ``scene_if`` (another scene),
            ``missing`` (of a thing that is not there), ``no_component`` (of a property without a Q-Map of its own) or
            ``unknown``.
        about: the candidates or objects that are named.
        component: the component that is named, if any.
        factors: for ``what_if``, how many times as much a component counts, by name.
        thing: what is missing; for ``number`` the number, for ``most`` the kind of thing, if one is named.
        lowest: for ``most``, whether the least is asked for.
    """

    kind: str
    about: list[Candidate] = field(default_factory=list)
    component: str | None = None
    factors: dict[str, float] = field(default_factory=dict)
    thing: str = ""
    lowest: bool = False


def understand(text: str, decision: Decision, words: Mapping[str, Any], before: Question | None = None) -> Question:
    """Reads a question; one that makes no sense as it stands is read again with its misspelled words mended.

    Args:
        text: what the person typed.
        decision: what it is about.
        words: the task's wording, for what components are called.
        before: the question before this one, which "and B?" refers back to.
    """
    vocabulary = Vocabulary.of(decision, words)
    question = _read(text, decision, words, vocabulary, before)
    if question.kind not in ("unknown", "missing"):
        return question
    components = [name for own in decision.components for name in (own, *words["synonyms"].get(own, []))]
    mended = respelled(text, [_VOCABULARY, *vocabulary.nouns, *vocabulary.looks, *components])
    return question if mended == plain(text) else _read(mended, decision, words, vocabulary, before)


def _read(
    text: str, decision: Decision, words: Mapping[str, Any], vocabulary: Vocabulary, before: Question | None
) -> Question:
    said = plain(text)
    about = named(text, decision, vocabulary)
    things = {word for c in (*decision.candidates, *decision.objects) for word in c.object.lower().split()}
    # "The color of the inclined block" is about color, "is it inclined" about flatness.
    apart = " ".join(word for word in said.split() if word not in things)
    mentioned = components_in(apart, decision.components, words) or components_in(said, decision.components, words)
    component = mentioned[0] if mentioned else None
    others = [candidate for candidate in about if candidate.label != SELECTED]
    supposed = re.search(_SUPPOSED, said) is not None
    if (thing := missing(text, decision, vocabulary)) and not supposed:
        return Question("missing", thing=thing)
    follows = re.search(r"^(and|what about|how about|or)\b", said) is not None
    if (
        before is not None
        and follows
        and not re.search(r"\bwhy\b|\bif\b", said)
        and (again := _again(said, before, others, component))
    ):
        return again
    kind = next(
        (
            kind
            for kind, pattern in ASKS.items()
            if re.search(vocabulary.within(pattern), said) and _fits(kind, said, about, component, vocabulary)
        ),
        "unknown",
    )
    strange = [name for name in (*words["components"], *words["other_properties"]) if name not in decision.components]
    foreign = components_in(said, strange, words)
    if foreign and not component and kind in ("what_if", "component_of", "meaning", "component", "most", "unknown"):
        return Question("no_component", component=foreign[0])
    if kind == "what_if":
        factors = factors_in(said, decision, words)
        if not factors and decision.selected in about and re.search(_GONE, said):
            return Question("runner_up")
        return Question("what_if" if factors else "scene_if", about, component, factors)
    if len(mentioned) > 1 and not about and re.search(r"\bor\b|\bthan\b", said):
        return Question("component")
    if kind == "number":
        return Question(kind, thing=re.findall(r"\d+[.,]\d+", said)[0].replace(",", "."))
    if kind == "most":
        nouns = {c.object.split()[-1].lower() for c in (*decision.candidates, *decision.objects)}
        noun = next((noun for noun in sorted(nouns) if re.search(rf"\b{re.escape(noun)}s?\b", said)), "")
        # "Rank the cubes" means the overall value, also where a component is called a rank.
        of = component if not said.startswith("rank ") or re.search(r"\b(by|in|for)\b", said) else None
        return Question(
            kind, component=of, thing=noun, lowest=re.search(r"\bworst\b|\blowest\b|\bleast\b", said) is not None
        )
    if kind == "contrastive" and not about and (unheard := re.search(r"\bwhy not (the |an? |that )?([a-z .]+)$", said)):
        described = [word for word in unheard.group(2).replace(".", " ").split() if not re.fullmatch(_ANYTHING, word)]
        if described:
            return Question("missing", thing=" ".join(described)) if unheard.group(1) else Question("unknown")
    if kind == "contrastive" or (kind == "rdx" and others):
        one_by_one = re.search(r"\bwhy\b.*\bnot\b|n.?t\b", said)
        if len(others) == 2 and len(about) == 2 and not one_by_one:
            return Question("pair", others)
        return Question("contrastive", others or about or decision.others[:1])
    refers = before is not None and re.search(r"\b(it|its|that|this one|there)\b", said)
    meant = before.about if before is not None and before.about and refers else [decision.selected]
    if kind in ("component_of", "values", "where") and not about:
        return Question(kind, meant, component)
    if kind == "shallow" and others:
        return Question("contrastive", others)
    if kind == "unknown" and (about or component):
        again = _again(said, before, others, component) if before is not None and len(said.split()) <= _SHORT else None
        alone = (
            Question("component_of", meant, component) if component else Question("contrastive", [decision.selected])
        )
        if again or others or component or len(said.split()) <= _SHORT:
            return again or (Question("contrastive", others) if others else alone)
    return Question(kind, about if kind in ("component_of", "values", "where", "who") else others, component)


def _fits(kind: str, said: str, about: list[Candidate], component: str | None, vocabulary: Vocabulary) -> bool:
    """Whether a pattern that matched can be meant, given who and what is named."""
    others = [candidate for candidate in about if candidate.label != SELECTED]
    if kind in ("component_of", "meaning"):
        return component is not None and not (kind == "meaning" and about)
    if kind == "values":
        return bool(about) or re.search(r"\bit\b|\byour choice\b|\bchosen\b|\bvalues\b|\bnumbers\b", said) is not None
    if kind == "who":
        return len(others) == 1 and others[0].label != others[0].object and component is None
    if kind == "most":
        aimed = component is not None or re.search(vocabulary.within(_RANKED), said)
        superlative = component is not None or re.search(ASKS["most"].rpartition("|^which")[0], said)
        return bool(aimed and superlative) and not others and not re.search(_NOT_RANKED, said)
    if kind == "q_value":
        return not others
    if kind == "what_if":
        return component is not None or re.search(_SUPPOSED, said) is not None
    return True


def _again(said: str, before: Question, others: list[Candidate], component: str | None) -> Question | None:
    """The question before, about somebody or something else: "and B?", "and 3 times as much?", "what about
    flatness?".
    """
    if before.kind == "pair" and others:
        return Question("contrastive", others)
    if before.kind not in _REPEATED:
        return None
    if before.kind == "what_if":
        bare = re.search(r"\d+(?:[.,]\d+)?$", said)
        factor, known = (
            float(bare.group().replace(",", ".")) if bare else factor_in(said),
            next(iter(before.factors.values())),
        )
        if component is None and factor is None:
            return None
        names = [component] if component else list(before.factors)
        return Question("what_if", [], names[0], dict.fromkeys(names, known if factor is None else factor))
    if others:
        return Question(before.kind, others, component or before.component)
    return (
        Question(before.kind, before.about, component)
        if component and before.kind in ("component_of", "meaning")
        else None
    )
