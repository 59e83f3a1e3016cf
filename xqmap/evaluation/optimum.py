"""Choices held against Q*, where a world can be solved: what a decision leads to counts, and not only what it pays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from xqmap import keys
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Solvable

# Values that differ by less are the same: rewards are single precision.
SAME_VALUE = 1e-4


class Optimum:
    """Follows the decisions of a run. A choice is optimal when R + γ V*(s') is V*(s), with V*(s) = max_o Σ_k w_k
    Q*_k(s, o): what really became of it counts.

    Args:
        env: the world.
        gamma: discount per decision.
        weights: w_k of the world's components, in their order.
    """

    def __init__(self, env: ManiSkillEnv, gamma: float, weights: Sequence[float]) -> None:
        self.env, self.gamma = env, gamma
        self._weights = np.asarray(weights, dtype=float)
        self._best: float | None = None
        self._got = self._discount = self._promised = 0.0
        self.optimal = self.asked = 0
        self.got = self.most = 0.0

    def begin(self) -> None:
        """A scene was set up."""
        self._best = self._value()
        self._got, self._discount, self._promised = 0.0, 1.0, self._best or 0.0

    def add(self, result: TensorDictBase) -> None:
        """A decision was made; ``result`` is what the environment returned (its ``next``)."""
        over = bool(result[keys.TERMINATED])
        following = 0.0 if over else self._value()
        reward = float(result[keys.REWARD])
        if self._best is not None and following is not None:
            self.optimal += int(self._best - (reward + self.gamma * following) < SAME_VALUE)
            self.asked += 1
        self._got, self._discount = self._got + self._discount * reward, self._discount * self.gamma
        # An episode that is cut short says nothing about its return.
        if over:
            self.got, self.most = self.got + self._got, self.most + self._promised
        self._best = following

    def found(self) -> dict[str, Any]:
        """What an evaluation keeps of a run: how many choices were ``asked`` about and ``optimal``, the discounted
        ``return`` of the episodes that came to their end, and the ``optimum`` of these.
        """
        return {"asked": self.asked, "optimal": self.optimal, "return": self.got, "optimum": self.most}

    def _value(self) -> float | None:
        exact = self.env.task.exact_values(self.gamma) if isinstance(self.env.task, Solvable) else None
        if exact is None:
            return None
        return float((np.asarray(exact, dtype=float) @ self._weights).max(initial=0.0))
