"""Where numbers go while training runs: ``metrics.csv``, and an offline wandb run beside it."""

from __future__ import annotations

import csv
import math
import os
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from torch import Tensor

from xqmap import keys
from xqmap.evaluation import SAME_REWARD


class Log:
    """Writes each row of metrics to ``metrics.csv`` and to wandb.

    Args:
        directory: the run directory.
        cfg: the whole configuration; ``cfg.logger.mode`` is offline, online or disabled.
        columns: the metrics' names, with ``/`` between group and component.
        after: rows of an earlier part of this run up to this ``frames`` are kept.
        wandb_id: of the run to go on with; None for a new one.
    """

    def __init__(self, directory: Path, cfg: DictConfig, columns: list[str], after: int = 0, wandb_id: str | None = None) -> None:
        self.columns = columns
        path = directory / "metrics.csv"
        kept = _rows(path, after) if after else []
        self._file = open(path, "w", newline="", encoding="utf-8")  # noqa: SIM115 (lives as long as the log)
        self._csv = csv.DictWriter(self._file, columns)
        self._csv.writeheader()
        self._csv.writerows(kept)
        self._wandb: Any = None
        self.wandb_id = wandb_id
        if cfg.logger.mode != "disabled":
            self._start_wandb(directory, cfg)

    def _start_wandb(self, directory: Path, cfg: DictConfig) -> None:
        os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
        os.environ.setdefault("WANDB_DATA_DIR", str(directory / "wandb"))
        import wandb
        from torchrl.record.loggers.wandb import WandbLogger

        self._wandb = WandbLogger(
            exp_name=directory.name,
            offline=cfg.logger.mode == "offline",
            save_dir=str(directory),
            project=cfg.logger.project,
            id=self.wandb_id,
            log_env_packages=False,
            config=OmegaConf.to_container(cfg, resolve=True),
            settings=wandb.Settings(x_disable_stats=True, console="off", silent=True),
        )
        self.wandb_id = self._wandb.experiment.id

    def row(self, values: dict[str, float]) -> None:
        """One step's metrics; must hold ``frames``. What is not known yet stays empty."""
        self._csv.writerow({name: value for name, value in values.items() if math.isfinite(value)})
        self._file.flush()
        if self._wandb is not None:
            self._wandb.experiment.log({name: value for name, value in values.items() if math.isfinite(value)}, step=int(values["frames"]))

    def picture(self, name: str, path: Path, frames: int) -> None:
        """A picture file, into wandb."""
        if self._wandb is not None:
            import wandb

            self._wandb.experiment.log({name: wandb.Image(str(path))}, step=frames)

    def close(self) -> None:
        """Ends the wandb run, so that the next one in this process gets an id of its own."""
        self._file.close()
        if self._wandb is not None:
            self._wandb.experiment.finish()


def _rows(path: Path, after: int) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if row["frames"] and float(row["frames"]) <= after]


class Tracker:
    """What the training's own decisions say: success, returns and the bias of Q, by component.

    Args:
        components: names of the task's components.
        values: names of the Q-Maps (one, ``reward``, for normal Q-learning).
        reward_key: the rewards the Q-Maps are learned for.
        gamma: discount per decision.
        window: decisions that ``success`` looks back on.
    """

    def __init__(self, components: Iterable[str], values: Iterable[str], reward_key: str, gamma: float, window: int = 100) -> None:
        self.components, self.values, self.reward_key, self.gamma = tuple(components), tuple(values), reward_key, gamma
        self.correct: deque[float] = deque(maxlen=window)
        self._episode: list[TensorDictBase] = []

    @property
    def success(self) -> float:
        """Share of best choices among the last decisions, exploration included."""
        return sum(self.correct) / len(self.correct) if self.correct else float("nan")

    def add(self, batch: TensorDictBase) -> dict[str, float]:
        """Takes ``[T]`` successive decisions; returns the metrics of the episodes that ended with them (NaN where none did)."""
        returns: list[Tensor] = []
        bias: list[Tensor] = []
        for decision in batch.unbind(0):
            gap = float(decision["next", keys.REWARD_AVAILABLE] - decision["next", keys.REWARD])
            self.correct.append(float(gap < SAME_REWARD))
            self._episode.append(decision.select(keys.CHOSEN_COMPONENT_VALUE, ("next", self.reward_key), ("next", keys.REWARD_COMPONENTS)))
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

    def names(self) -> list[str]:
        """The names of what :meth:`add` returns."""
        return ["success", "reward", *(f"return/{n}" for n in self.components), *(f"q_bias/{n}" for n in self.values)]


def _named(group: str, names: tuple[str, ...], values: list[Tensor]) -> dict[str, float]:
    mean = torch.stack(values).mean(0).tolist() if values else [float("nan")] * len(names)
    return {f"{group}/{name}": value for name, value in zip(names, mean, strict=True)}
