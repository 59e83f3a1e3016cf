"""From one decision to maps, bars, sentences and pages."""

from xqmap.explanations.candidate import Candidate
from xqmap.explanations.speaking import Decision

__all__ = ["Candidate", "Decision"]
