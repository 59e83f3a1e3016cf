"""What hangs on a training: its progress bar, pictures, checkpoints and signals."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from omegaconf import DictConfig
from tensordict import TensorDict
from tqdm import tqdm

from xqmap import keys, launch
from xqmap.errors import Stopped
from xqmap.evaluation.statistics import wilson
from xqmap.explanations import Decision
from xqmap.explanations.scene import Scene
from xqmap.explanations.views import plots
from xqmap.runs import checkpoint
from xqmap.trainers.trainer import Callback, Saved, Trainer


def make_trainer(cfg: DictConfig, directory: Path, saved: Saved | None = None) -> Trainer:
    """A training that leaves what a run directory holds; see :class:`Trainer`."""
    # A checkpoint keeps when the next picture is due.
    return Trainer(cfg, directory, saved, [Signals(), Pictures(), Progress(), Checkpoints()])


class Progress(Callback):
    """A bar of decisions with an ETA, the recent share of best choices and ε."""

    _bar: tqdm[Any] | None = None

    def start(self, trainer: Trainer) -> None:
        """Opens it, at the decision that is gone on from."""
        self._bar = tqdm(
            total=trainer.cfg.trainer.frames,
            initial=trainer.frames,
            unit="decision",
            desc="training",
            mininterval=1.0,
        )

    def step(self, trainer: Trainer, row: dict[str, float]) -> None:
        """Moves it."""
        if self._bar is not None:
            self._bar.set_postfix(
                best=f"{trainer.tracker.success:.0%}", ε=f"{trainer.exploration.eps:.2f}", refresh=False
            )
            self._bar.update(trainer.frames - self._bar.n)

    def end(self, trainer: Trainer) -> None:
        """Leaves it as it is."""
        if self._bar is not None:
            self._bar.close()


class Pictures(Callback):
    """Every ``trainer.picture_period`` decisions the Q-Maps as they are then, over the first scene remembered."""

    _next = 0

    def step(self, trainer: Trainer, row: dict[str, float]) -> None:
        """Draws, when it is time."""
        if trainer.frames < self._next:
            return
        self._next = trainer.frames + trainer.cfg.trainer.picture_period
        image = trainer.replay.first().to(trainer.device)
        cells = np.full(image.shape[-2:], -1)
        world = trainer.env
        scene = Scene([], cells, world.task.BACKGROUND, world.grid.bounds, image[3].cpu().numpy())
        state = TensorDict({keys.HEIGHTMAP: image, keys.ACTION_MASK: (image != 0).any(0).flatten()})
        decision = Decision.from_policy(
            trainer.greedy, state, scene, task=trainer.cfg.task.name, components=trainer.cfg.method.components
        )
        path = trainer.directory / "figures" / f"qmaps{trainer.frames:06d}"
        path.parent.mkdir(exist_ok=True)
        trainer.log.picture("qmaps", plots.save(plots.qmaps(decision), path)[0], trainer.frames)

    def facts(self) -> dict[str, Any]:
        """When the next one is due."""
        return {"next_picture": self._next}

    def restore(self, facts: dict[str, Any]) -> None:
        """See :meth:`facts`."""
        self._next = facts["next_picture"]


class Checkpoints(Callback):
    """Every ``trainer.checkpoint_period`` decisions and at the end the policy to hand out, the best there was, and
    everything needed to go on.
    """

    def __init__(self) -> None:
        self._best, self._next = -1.0, 0

    def step(self, trainer: Trainer, row: dict[str, float]) -> None:
        """Saves, when it is time."""
        if trainer.over or trainer.frames >= self._next:
            self.save(trainer)

    def lost(self, trainer: Trainer) -> None:
        """Saves."""
        self.save(trainer)

    def save(self, trainer: Trainer) -> None:
        """Writes all three."""
        self._next = trainer.frames + trainer.cfg.trainer.checkpoint_period
        weights, facts = trainer.network.state_dict(), trainer.facts()
        checkpoint.write(trainer.directory / checkpoint.POLICY, weights, facts)
        # By the lower end of the interval, so that four lucky decisions are not the best there were.
        low, _ = wilson(int(sum(trainer.tracker.correct)), len(trainer.tracker.correct))
        if low >= self._best:
            self._best = low
            checkpoint.write(trainer.directory / checkpoint.BEST, weights, facts)
        checkpoint.write(trainer.directory / checkpoint.TRAINING.format(trainer.frames), *trainer.state())
        checkpoint.prune(trainer.directory, trainer.frames, trainer.cfg.trainer.keep_last)
        trainer.saved_frames = trainer.frames

    def facts(self) -> dict[str, Any]:
        """How good the best was."""
        return {"best": self._best}

    def restore(self, facts: dict[str, Any]) -> None:
        """See :meth:`facts`; the next is due a period after the one that is gone on from."""
        self._best = facts["best"]
        self._next = facts["frames"] + facts["config"]["trainer"]["checkpoint_period"]


class Signals(Callback):
    """Ends a training that is asked to stop after the present batch, saved; asked again, at once."""

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}

    def start(self, trainer: Trainer) -> None:
        """Listens."""

        def stop(number: int, frame: FrameType | None) -> None:
            if trainer.stopped_by is None:
                trainer.stopped_by = number
                tqdm.write("stopping when this step is saved; once more: at once", file=sys.stderr)
            elif number != signal.SIGHUP:  # of which a shell and the system both send one
                raise Stopped(number)

        self._before = {number: signal.signal(number, stop) for number in (signal.SIGINT, *launch.stopping())}

    def end(self, trainer: Trainer) -> None:
        """Gives the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
