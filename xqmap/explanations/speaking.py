"""A decision that speaks for itself: in sentences, in answers, and in a notebook as a page or a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Self

from xqmap.errors import UserError
from xqmap.explanations import decision, values
from xqmap.explanations.candidate import SELECTED, Candidate
from xqmap.explanations.views import sentences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from xqmap.explanations.dialogue.conversation import Dialogue

# Of the picture in a notebook; a page of its own is sharper.
_WIDTH = 1200


class Decision(decision.Decision):
    """A policy's choice in one state, with what it says, answers and shows.

    Its numbers, and how one is made, are those of :class:`xqmap.explanations.decision.Decision`, which all views read.
    """

    @classmethod
    def from_values(
        cls,
        q: Any,
        actions: Sequence[str],
        components: Sequence[str],
        weights: Sequence[float] | Mapping[str, float] | None = None,
        mask: Any = None,
        errors: Sequence[float] | Mapping[str, float] | None = None,
        *,
        task: str = "actions",
        step: int = 0,
    ) -> Self:
        """The choice of any agent that has a value for each component and action; it takes the highest weighted sum.

        Everything that needs no picture works on it: sentences, bars, conversations, pages, files.

        Args:
            q: ``[K, A]``, a tensor or an array.
            actions: A names, as they are to stand in a sentence; one without an article gets "the".
            components: K names.
            weights: w_k, 1 each when not given: in the order of the components, or by name.
            mask: ``[A]``, the actions that can be chosen; all when not given.
            errors: typical error of each component's values, in their order or by name; without, nothing is called a
                toss-up.
            task: its name; a file of that name in ``conf/explain/wording`` has its words.
            step: how many decisions of the episode went before.

        Raises:
            UserError: naming the argument that does not fit.

        Examples:
            >>> import numpy as np
            >>> q = np.array([[1.0, 0.9, 0.1], [-2.0, -0.3, 0.0]])
            >>> decision = Decision.from_values(q, ["step left", "step right", "step back"], ["gold", "safety"])
            >>> print(decision.why("left"))  # doctest: +NORMALIZE_WHITESPACE
            I chose the step right rather than the step left (A), because safety speaks for it (+1.70), though gold
            speaks against it (-0.10). If safety counted 0.06 times as much, the step left would be just as good.
        """
        return cls(task, step=step, **values.read(q, actions, components, weights, mask, errors))

    def why(self, other: str | None = None) -> str:
        """Why this one: all sentences, one a line; or why not the ``other``.

        Args:
            other: a candidate's label (``"B"``), or the name of an object; words of it are enough where no other has
                them.

        Raises:
            UserError: if nothing here goes by that name.
        """
        if other is None:
            return sentences.why(self)
        words, meant = sentences.wording_of(self), self._named(other)
        if meant.label == SELECTED:
            return sentences.shallow(self, words)
        return sentences.contrastive(self, self.selected, meant, words)

    def ask(self, question: str) -> str:
        """The answer to a question in one's own words, from the decision's numbers alone; a question may refer to the
        one before ("and B?").
        """
        return self._talk().ask(question).answer

    def show(self) -> Figure:
        """Q-Maps, where there are any, bars and sentences in one picture; a notebook shows it, ``.savefig(path)`` keeps
        it.
        """
        # Charts and conversations take a second, which numbers need not wait for.
        from xqmap.explanations.views import plots

        return plots.overview(self)

    def _talk(self) -> Dialogue:
        # As in show().
        from xqmap.explanations.dialogue.conversation import Dialogue

        talk: Dialogue = vars(self).setdefault("_dialogue", Dialogue(self, sentences.wording_of(self)))
        return talk

    def _repr_html_(self) -> str:
        """The page of ``python -m xqmap.explain``, with what was asked, in a frame of its own."""
        # As in show().
        from xqmap.explanations.views.page import page

        talk = [(exchange.question, exchange.answer) for exchange in self._talk().exchanges]
        content = escape(page([self], talk, _WIDTH), quote=True)
        return f'<iframe srcdoc="{content}" style="width:100%;height:44em;border:0" sandbox="allow-scripts"></iframe>'

    def _repr_png_(self) -> bytes:
        """:meth:`show` as a picture, for notebooks that show no pages."""
        # As in show().
        from xqmap.explanations.views.style import rendered

        return rendered(self.show(), "png", dpi=80)

    def _named(self, other: str) -> Candidate:
        known = [*self.candidates, *self.objects]
        for names in ([c.label for c in self.candidates], [c.object for c in known]):
            if other in names:
                return known[names.index(other)]
        words = set(other.lower().split())
        meant = {c.object: c for c in reversed(known) if words and words <= set(c.object.lower().split())}
        if len(meant) == 1:
            return next(iter(meant.values()))
        there = ", ".join(dict.fromkeys([c.label for c in self.candidates] + [c.object for c in known]))
        raise UserError(f"nothing here is called {other!r}; there are {there}")
