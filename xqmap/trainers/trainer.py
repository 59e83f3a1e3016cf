"""The training loop: collect decisions, remember them, learn from batches of them, log. All else hangs on it: see
:mod:`xqmap.trainers.callbacks`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.objectives import HardUpdate

from xqmap import keys
from xqmap.collectors import collect
from xqmap.config import build
from xqmap.errors import UserError, WorkerLost
from xqmap.evaluation.play import training_scenes
from xqmap.models.policy import GreedyPolicy
from xqmap.objectives.kept import Kept
from xqmap.trainers import randomness
from xqmap.trainers.logger import Log
from xqmap.trainers.tracker import Tracker

Saved = tuple[dict[str, Tensor], dict[str, Any]]


class Callback:
    """What hangs on a training. Of each batch of decisions all callbacks hear in their order."""

    def start(self, trainer: Trainer) -> None:
        """The first decision is about to be made."""

    def step(self, trainer: Trainer, row: dict[str, float]) -> None:
        """A batch of decisions was learned from; ``row`` is what was logged of it."""

    def lost(self, trainer: Trainer) -> None:
        """A worker was lost; what came before is whole."""

    def end(self, trainer: Trainer) -> None:
        """Training is over, however it ended; :meth:`start` may not have been reached."""

    def facts(self) -> dict[str, Any]:
        """What a checkpoint keeps of this callback: JSON."""
        return {}

    def restore(self, facts: dict[str, Any]) -> None:
        """The inverse of :meth:`facts`, of a whole checkpoint's."""


class Trainer:
    """One training of one agent in one world.

    Args:
        cfg: validated settings.
        directory: the run directory; it exists and can be written.
        saved: tensors and facts of the checkpoint to go on from (``checkpoint.read_training``); None begins.
        callbacks: what hangs on it.
    """

    def __init__(
        self, cfg: DictConfig, directory: Path, saved: Saved | None = None, callbacks: Sequence[Callback] = ()
    ) -> None:
        collect.outlive_the_terminal()
        self.cfg, self.directory, self.callbacks = cfg, directory, callbacks
        torch.manual_seed(cfg.seed)
        self.device = build.device(cfg)
        self.frames = self.updates = self.saved_frames = 0
        # Actions of the present episode: played again in its scene, they lead to the present state.
        self.unfinished: list[int] = []
        self.seconds = {"infer": 0.0, "update": 0.0}
        # Number of the signal that asked to stop; whether this is the last batch.
        self.stopped_by: int | None = None
        self.over = False
        # Running mean of |TD error|, by Q-Map: how far its values are typically off.
        self.noise: dict[str, float] = {}

        first_scene = saved[1]["scene"] if saved else training_scenes(cfg.seed)
        self.env = build.make_env(build.practice(cfg), first_scene)()
        self.network = build.qmaps(cfg, self.env.grid.pixel_size)
        self.kept = Kept(cfg.trainer.choice_period)
        self.loss = build.loss(cfg, self.network, self.kept)
        self.target_updater = HardUpdate(self.loss, value_network_update_interval=cfg.trainer.target_period)
        self.parameters = [p for p in self.loss.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(self.parameters, lr=cfg.trainer.learning_rate)
        self.replay = build.replay(cfg)
        self.exploration = build.exploration(cfg)
        self.greedy = GreedyPolicy(self.network)
        self._time_policy()
        self.tracker = Tracker(cfg.task.components, cfg.method.components, cfg.method.reward_key, cfg.loss.gamma)
        if saved:
            try:
                self._restore(*saved)
            except (KeyError, ValueError, TypeError, RuntimeError, AttributeError, IndexError) as error:
                self.env.close()
                raise UserError(
                    f"the checkpoint in {directory} does not fit its own settings ({str(error)[:200]})"
                ) from None
        self.autocast = torch.autocast(self.device.type, torch.bfloat16, enabled=build.bf16(cfg))
        self.log = Log(directory, cfg, self._columns(), self.frames, saved[1]["wandb_id"] if saved else None)

    def run(self) -> GreedyPolicy:
        """Trains to ``trainer.frames`` decisions, or until ``stopped_by`` is set.

        Returns:
            The greedy policy as learned.
        """
        try:
            if self.frames < self.cfg.trainer.frames:
                self._run()
        finally:
            self.log.close()
        return self.greedy

    def _run(self) -> None:
        drawn = randomness.states(self.generators())
        explored = self.exploration.frames.clone()
        policy, alone = TensorDictSequential(self.greedy, self.exploration), self.cfg.collector.name == "single"
        collector = collect.collector(self.cfg, self.env, policy, self.frames)
        # A new collector tries the policy once; that must not use up random numbers, or a resumed run would differ.
        self.exploration.frames.copy_(explored)
        randomness.restore(drawn, self.generators())
        start = time.perf_counter()
        try:
            for callback in self.callbacks:
                callback.start(self)
            for batch in collect.batches(collector, self.cfg.collector):
                row = self._step(batch.reshape(-1))
                if not alone:
                    self.exploration.frames.fill_(self.frames)
                    collect.share(collector, policy)
                row["seconds"] = time.perf_counter() - start
                self.log.row(row)
                self.over = self.stopped_by is not None or self.frames >= self.cfg.trainer.frames
                for callback in self.callbacks:
                    callback.step(self, row)
                if self.over:
                    break
        except WorkerLost:
            for callback in self.callbacks:
                callback.lost(self)
            raise
        finally:
            for callback in self.callbacks:
                callback.end(self)
            collect.close(collector, alone)

    def state(self) -> Saved:
        """Everything needed to go on: tensors, and facts that are JSON."""
        tensors: dict[str, Tensor] = {
            f"loss/{name}": value for name, value in self.loss.state_dict().items() if isinstance(value, Tensor)
        }
        for i, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{i}/{name}": value for name, value in state.items()}
        parts = {
            "random": randomness.states(self.generators()),
            "replay": self.replay.contents(),
            "tracker": self.tracker.state_dict(),
            "kept": self.kept.state_dict(),
        }
        tensors |= {f"{part}/{name}": value for part, contents in parts.items() for name, value in contents.items()}
        facts: dict[str, Any] = self.facts() | {
            "updates": self.updates,
            "scene": self.env.scene_seed,
            "unfinished": self.unfinished,
            "explored": int(self.exploration.frames),
            "cursor": self.replay.cursor,
            "target_age": self.target_updater.counter,
            "wandb_id": self.log.wandb_id,
            "threads": torch.get_num_threads(),
        }
        for callback in self.callbacks:
            facts |= callback.facts()
        return tensors, facts

    def facts(self) -> dict[str, Any]:
        """What belongs beside the weights that are handed out."""
        return {
            "config": OmegaConf.to_container(self.cfg, resolve=True),
            "pixel_size": self.env.grid.pixel_size,
            "frames": self.frames,
            "noise": self.noise,
            "success": self.tracker.success,
        }

    def close(self) -> None:
        """Frees the simulator, and the log of a training that never ran."""
        self.env.close()
        self.log.close()

    def _step(self, batch: TensorDictBase) -> dict[str, float]:
        """Remembers a batch of decisions, learns, and returns its row of metrics."""
        self.kept.forget(self.replay.extend(batch))
        self.frames += len(batch)
        for action, done in zip(batch[keys.ACTION].tolist(), batch["next", keys.DONE].flatten().tolist(), strict=True):
            self.unfinished = [] if done else [*self.unfinished, action]
        row = {"frames": float(self.frames), "eps": self.exploration.eps, **self.tracker.add(batch)}
        row |= {f"metric/{name}": float(batch["next", name].mean()) for name in self.env.metric_names}
        if self.frames >= self.cfg.trainer.warmup_frames:
            start = time.perf_counter()
            due = round(self.cfg.trainer.updates_per_frame * (self.frames - self.cfg.trainer.warmup_frames))
            losses = [self._update() for _ in range(due - self.updates)]
            if losses:
                mean: TensorDictBase = torch.stack(losses).mean(0).cpu()
                row |= {_grouped(name): float(value) for name, value in mean.items()}
                for name in self.cfg.method.components:
                    error = row[f"td_error/{name}"]
                    self.noise[name] = error + 0.95 * (self.noise.get(name, error) - error)
            self.seconds["update"] += time.perf_counter() - start
        row["updates"] = float(self.updates)
        row |= {f"share/{name}": value for name, value in self._shares().items()}
        return row

    def _update(self) -> TensorDictBase:
        """One gradient step on one batch, the same for all components."""
        progress = min(1.0, self.updates / max(1.0, self.cfg.trainer.updates_per_frame * self.cfg.trainer.frames))
        batch = self.replay.sample(progress).to(self.device)
        for group in self.optimizer.param_groups:
            group["lr"] = self.cfg.trainer.learning_rate * (0.55 + 0.45 * math.cos(math.pi * progress))
        with self.autocast:
            losses = self.loss(batch)
        total = sum(value for name, value in losses.items() if name.startswith("loss_"))
        if not bool(torch.isfinite(total)):
            raise UserError(
                f"the loss became {float(total.detach())} at update {self.updates}: lower trainer.learning_rate"
            )
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, self.cfg.trainer.max_grad_norm)
        if not bool(torch.isfinite(norm)):
            raise UserError(f"the gradient became {float(norm)} at update {self.updates}: lower trainer.learning_rate")
        self.optimizer.step()
        self.target_updater.step()
        self.kept.step(moved=self.target_updater.counter == 0)
        self.replay.learned(batch)
        self.updates += 1
        return losses.detach()

    def _restore(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
        """The inverse of :meth:`state`; the world goes on in the middle of the episode it was in."""
        names = ("loss", "optimizer", "random", "replay", "tracker", "kept")
        parts: dict[str, dict[str, Tensor]] = {name: {} for name in names}
        for name, tensor in tensors.items():
            part, _, rest = name.partition("/")
            parts[part][rest] = tensor
        self.loss.load_state_dict(parts["loss"], strict=False)
        optimizer = self.optimizer.state_dict()
        for name, tensor in parts["optimizer"].items():
            i, _, key = name.partition("/")
            optimizer["state"].setdefault(int(i), {})[key] = tensor
        self.optimizer.load_state_dict(optimizer)
        self.replay.restore(parts["replay"], facts["cursor"])
        self.tracker.load_state_dict(parts["tracker"])
        self.kept.load_state_dict(parts["kept"])
        self.frames = self.saved_frames = facts["frames"]
        self.updates, self.noise = facts["updates"], facts["noise"]
        self.exploration.frames.fill_(facts["explored"])
        self.target_updater.counter = facts["target_age"]
        self.unfinished = [int(action) for action in facts["unfinished"]]
        self.env.unfinished = list(self.unfinished)
        for callback in self.callbacks:
            callback.restore(facts)
        randomness.restore(parts["random"], self.generators())
        # Sums are taken in another order by another number of threads, and the weights would be others.
        torch.set_num_threads(facts.get("threads", torch.get_num_threads()))

    def generators(self) -> dict[str, torch.Generator]:
        """What it draws from, beside the global ones."""
        return {"replay": self.replay.generator, "exploration": self.exploration.generator}

    def _time_policy(self) -> None:
        started = [0.0]

        def stop(*_: Any) -> None:
            self.seconds["infer"] += time.perf_counter() - started[0]

        self.greedy.register_forward_pre_hook(lambda *_: started.__setitem__(0, time.perf_counter()))
        self.greedy.register_forward_hook(stop)

    def _shares(self) -> dict[str, float]:
        seconds = {**self.env.seconds, **self.seconds}
        return {name: value / max(1e-9, sum(seconds.values())) for name, value in seconds.items()}

    def _columns(self) -> list[str]:
        names = self.loss.out_keys
        return [
            *("frames", "updates", "seconds", "eps"),
            *self.tracker.names(),
            *(_grouped(name) for name in names),
            *(f"metric/{name}" for name in self.env.metric_names),
            *(f"share/{name}" for name in {**self.env.seconds, **self.seconds}),
        ]


def _grouped(name: str) -> str:
    """``td_error_color`` → ``td_error/color``: wandb groups its charts by what stands before the slash."""
    for group in ("loss", "td_error", "value"):
        if name.startswith(f"{group}_"):
            return f"{group}/{name.removeprefix(f'{group}_')}"
    return name
