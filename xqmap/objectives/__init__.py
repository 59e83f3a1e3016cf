"""What is minimised."""

from xqmap.objectives.decomposed_dqn import DecomposedDQNLoss

__all__ = ["DecomposedDQNLoss"]
