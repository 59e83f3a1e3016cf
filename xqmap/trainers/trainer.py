"""The training loop: collect decisions, remember them, learn from batches of them, log, save."""

from __future__ import annotations

import math
import signal
import sys
import time
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torch import Tensor
from torchrl.objectives import HardUpdate
from tqdm import tqdm

from xqmap import keys
from xqmap.collectors import collect
from xqmap.config import build
from xqmap.errors import Stopped, UserError, WorkerLost
from xqmap.evaluation.play import training_scenes
from xqmap.evaluation.statistics import wilson
from xqmap.explanations import Decision
from xqmap.explanations.perception import Scene
from xqmap.explanations.views import plots
from xqmap.models.policy import GreedyPolicy
from xqmap.runs import checkpoint
from xqmap.trainers import randomness
from xqmap.trainers.logger import Log
from xqmap.trainers.tracker import Tracker


class Trainer:
    """One training of one agent in one world.

    Args:
        cfg: validated settings.
        directory: the run directory; it exists and can be written.
        saved: tensors and facts of the checkpoint to go on from (``checkpoint.read_training``); None begins.
    """

    def __init__(
        self, cfg: DictConfig, directory: Path, saved: tuple[dict[str, Tensor], dict[str, Any]] | None = None
    ) -> None:
        self.cfg, self.directory = cfg, directory
        torch.manual_seed(cfg.seed)
        self.device = build.device(cfg)
        self.frames = self.updates = self.next_checkpoint = self.next_picture = self.saved_frames = 0
        self.best = -1.0
        # Actions of the present episode: played again in its scene, they lead to the present state.
        self.unfinished: list[int] = []
        self.seconds = {"infer": 0.0, "update": 0.0}
        self.stopped_by: int | None = None
        # Running mean of |TD error|, by Q-Map: how far its values are typically off.
        self.noise: dict[str, float] = {}

        first_scene = saved[1]["scene"] if saved else training_scenes(cfg.seed)
        self.env = build.make_env(cfg, first_scene)()
        self.network = build.qmaps(cfg, self.env.grid.pixel_size)
        self.loss = build.loss(cfg, self.network)
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
        """Trains to ``trainer.frames`` decisions, or until a signal asks to stop; saves either way.

        Returns:
            The greedy policy as learned.
        """
        if self.frames >= self.cfg.trainer.frames:
            self.log.close()
            return self.greedy
        drawn = randomness.states(self._generators())
        explored = self.exploration.frames.clone()
        policy, alone = TensorDictSequential(self.greedy, self.exploration), self.cfg.collector.name == "single"
        collector = collect.collector(self.cfg, self.env, policy, self.frames)
        # A new collector tries the policy once; that must not use up random numbers, or a resumed run would differ.
        self.exploration.frames.copy_(explored)
        randomness.restore(drawn, self._generators())
        handlers = {number: signal.signal(number, self._stop) for number in (signal.SIGINT, signal.SIGTERM)}
        start, already = time.perf_counter(), self.frames
        try:
            with tqdm(
                total=self.cfg.trainer.frames, initial=already, unit="decision", desc="training", mininterval=1.0
            ) as bar:
                for batch in collect.batches(collector, self.cfg.collector):
                    row = self._step(batch.reshape(-1))
                    if not alone:
                        self.exploration.frames.fill_(self.frames)
                        collect.share(collector, policy)
                    row["seconds"] = time.perf_counter() - start
                    self.log.row(row)
                    if self.frames >= self.next_picture:
                        self._draw()
                    bar.set_postfix(best=f"{self.tracker.success:.0%}", ε=f"{self.exploration.eps:.2f}", refresh=False)
                    bar.update(self.frames - bar.n)
                    over = self.stopped_by or self.frames >= self.cfg.trainer.frames
                    if over or self.frames >= self.next_checkpoint:
                        self.save()
                    if over:
                        break
        except WorkerLost:
            self.save()
            raise
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            collect.close(collector, alone)
            self.log.close()
        return self.greedy

    def save(self) -> None:
        """Writes the policy to hand out, keeps the best, and writes everything needed to go on."""
        self.next_checkpoint = self.frames + self.cfg.trainer.checkpoint_period
        facts: dict[str, Any] = {
            "config": OmegaConf.to_container(self.cfg, resolve=True),
            "pixel_size": self.env.grid.pixel_size,
        }
        facts |= {"frames": self.frames, "noise": self.noise, "success": self.tracker.success}
        checkpoint.write(self.directory / checkpoint.POLICY, self.network.state_dict(), facts)
        # By the lower end of the interval, so that four lucky decisions are not the best there were.
        low, _ = wilson(int(sum(self.tracker.correct)), len(self.tracker.correct))
        if low >= self.best:
            self.best = low
            checkpoint.write(self.directory / checkpoint.BEST, self.network.state_dict(), facts)
        tensors: dict[str, Tensor] = {
            f"loss/{name}": value for name, value in self.loss.state_dict().items() if isinstance(value, Tensor)
        }
        for i, state in self.optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer/{i}/{name}": value for name, value in state.items()}
        parts = {
            "random": randomness.states(self._generators()),
            "replay": self.replay.contents(),
            "tracker": self.tracker.state_dict(),
        }
        tensors |= {f"{part}/{name}": value for part, contents in parts.items() for name, value in contents.items()}
        facts |= {
            "updates": self.updates,
            "scene": self.env.scene_seed,
            "unfinished": self.unfinished,
            "explored": int(self.exploration.frames),
            "cursor": self.replay.cursor,
            "target_age": self.target_updater.counter,
            "next_picture": self.next_picture,
            "best": self.best,
            "wandb_id": self.log.wandb_id,
        }
        checkpoint.write(self.directory / checkpoint.TRAINING.format(self.frames), tensors, facts)
        checkpoint.prune(self.directory, self.frames, self.cfg.trainer.keep_last)
        self.saved_frames = self.frames

    def close(self) -> None:
        """Frees the simulator."""
        self.env.close()

    def _step(self, batch: TensorDictBase) -> dict[str, float]:
        """Remembers a batch of decisions, learns, and returns its row of metrics."""
        self.replay.extend(batch)
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
        self.replay.learned(batch)
        self.updates += 1
        return losses.detach()

    def _restore(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
        """The inverse of :meth:`save`; the world goes on in the middle of the episode it was in."""
        parts: dict[str, dict[str, Tensor]] = {"loss": {}, "optimizer": {}, "random": {}, "replay": {}, "tracker": {}}
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
        self.frames = self.saved_frames = facts["frames"]
        self.updates, self.noise, self.best = facts["updates"], facts["noise"], facts["best"]
        self.exploration.frames.fill_(facts["explored"])
        self.target_updater.counter = facts["target_age"]
        self.unfinished = [int(action) for action in facts["unfinished"]]
        self.env.unfinished = list(self.unfinished)
        self.next_checkpoint = self.frames + self.cfg.trainer.checkpoint_period
        self.next_picture = facts["next_picture"]
        randomness.restore(parts["random"], self._generators())

    def _generators(self) -> dict[str, torch.Generator]:
        return {"replay": self.replay.generator, "exploration": self.exploration.generator}

    def _draw(self) -> None:
        """The Q-Maps as they are now, over the first scene that was remembered."""
        self.next_picture = self.frames + self.cfg.trainer.picture_period
        image = self.replay.first().to(self.device)
        cells = np.full(image.shape[-2:], -1)
        scene = Scene([], cells, self.env.task.BACKGROUND, self.env.grid.bounds, image[3].cpu().numpy())
        state = TensorDict({keys.HEIGHTMAP: image, keys.ACTION_MASK: (image != 0).any(0).flatten()})
        decision = Decision.from_policy(
            self.greedy, state, scene, task=self.cfg.task.name, components=self.cfg.method.components
        )
        path = self.directory / "figures" / f"qmaps{self.frames:06d}"
        path.parent.mkdir(exist_ok=True)
        self.log.picture("qmaps", plots.save(plots.qmaps(decision), path)[0], self.frames)

    def _time_policy(self) -> None:
        started = [0.0]

        def stop(*_: Any) -> None:
            self.seconds["infer"] += time.perf_counter() - started[0]

        self.greedy.register_forward_pre_hook(lambda *_: started.__setitem__(0, time.perf_counter()))
        self.greedy.register_forward_hook(stop)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        if self.stopped_by is not None:
            raise Stopped(number)
        self.stopped_by = number
        tqdm.write("stopping when this step is saved; once more: at once", file=sys.stderr)

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
