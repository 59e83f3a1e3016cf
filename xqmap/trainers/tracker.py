"""What the training's own decisions say: success, returns and the bias of Q, by component."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from xqmap import keys
from xqmap.evaluation.play import SAME_REWARD


class Tracker:
    """What the training's own decisions say: success, returns and the bias of Q, by component.

    Args:
        components: names of the task's components.
        values: names of the Q-Maps (one, ``reward``, for normal Q-learning).
        reward_key: the rewards the Q-Maps are learned for.
        gamma: discount per decision.
        window: decisions that ``success`` looks back on.
    """

    def __init__(
        self, components: Iterable[str], values: Iterable[str], reward_key: str, gamma: float, window: int = 100
    ) -> None:
        self.components, self.values, self.reward_key, self.gamma = tuple(components), tuple(values), reward_key, gamma
        self.correct: deque[float] = deque(maxlen=window)
        self._episode: list[TensorDictBase] = []

    @property
    def success(self) -> float:
        """Share of best choices among the last decisions, exploration included."""
        return sum(self.correct) / len(self.correct) if self.correct else float("nan")

    def add(self, batch: TensorDictBase) -> dict[str, float]:
        """Takes ``[T]`` successive decisions; returns the metrics of the episodes that ended with them (NaN where none
        did).
        """
        returns: list[Tensor] = []
        bias: list[Tensor] = []
        for decision in batch.unbind(0):
            gap = float(decision["next", keys.REWARD_AVAILABLE] - decision["next", keys.REWARD])
            self.correct.append(float(gap < SAME_REWARD))
            self._episode.append(
                decision.select(
                    keys.CHOSEN_COMPONENT_VALUE, ("next", self.reward_key), ("next", keys.REWARD_COMPONENTS)
                )
            )
            if bool(decision["next", keys.DONE]):
                returns.append(sum(step["next", keys.REWARD_COMPONENTS] for step in self._episode))
                to_go = torch.zeros(len(self.values))
                for step in reversed(self._episode):
                    to_go = step["next", self.reward_key] + self.gamma * to_go
                    bias.append(step[keys.CHOSEN_COMPONENT_VALUE] - to_go)
                self._episode = []
        row = {"success": self.success, "reward": float(batch["next", keys.REWARD].mean())}
        row |= _named("return", self.components, returns) | _named("q_bias", self.values, bias)
        return row

    def state_dict(self) -> dict[str, Tensor]:
        """What the next rows depend on, by name."""
        episode = TensorDict.stack(self._episode).flatten_keys(".").items() if self._episode else ()
        return {"correct": torch.tensor(list(self.correct)), **{f"episode.{name}": value for name, value in episode}}

    def load_state_dict(self, contents: dict[str, Tensor]) -> None:
        """The inverse of :meth:`state_dict`."""
        self.correct.extend(contents["correct"].tolist())
        episode = {tuple(name.split(".")[1:]): value for name, value in contents.items() if name != "correct"}
        if episode:
            stored = TensorDict({}, batch_size=[len(next(iter(episode.values())))])
            for name, value in episode.items():
                stored[name] = value
            self._episode = list(stored.unbind(0))

    def names(self) -> list[str]:
        """The names of what :meth:`add` returns."""
        return ["success", "reward", *(f"return/{n}" for n in self.components), *(f"q_bias/{n}" for n in self.values)]


def _named(group: str, names: tuple[str, ...], values: list[Tensor]) -> dict[str, float]:
    mean = torch.stack(values).mean(0).tolist() if values else [float("nan")] * len(names)
    return {f"{group}/{name}": value for name, value in zip(names, mean, strict=True)}
