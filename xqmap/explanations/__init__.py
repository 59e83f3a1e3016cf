"""From one decision to maps, bars, sentences and pages."""

from xqmap.explanations.decision import Candidate, Decision

__all__ = ["Candidate", "Decision"]
