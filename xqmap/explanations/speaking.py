"""A decision that speaks for itself: in sentences, in answers, and in a notebook as a page or a picture."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from xqmap.errors import UserError
from xqmap.explanations import decision
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

    def why(self, other: str | None = None) -> str:
        """Why this one: all sentences, one a line; or why not the ``other``.

        Args:
            other: a candidate's label (``"B"``), or the name of an object.

        Raises:
            UserError: if nothing here goes by that name.
        """
        if other is None:
            return sentences.why(self)
        words, meant = sentences.wording_for(self.task), self._named(other)
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

        talk: Dialogue = vars(self).setdefault("_dialogue", Dialogue(self, sentences.wording_for(self.task)))
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
        for names in ([c.label for c in known], [c.object for c in known]):
            if other in names:
                return known[names.index(other)]
        there = ", ".join(dict.fromkeys([c.label for c in self.candidates] + [c.object for c in known]))
        raise UserError(f"nothing here is called {other!r}; there are {there}")
