"""Who makes the decisions that training learns from: one simulator in this process, worker processes, or machines of a Ray cluster.

All of it is torchrl's own; this file only says what a worker builds, and turns a worker's end into one clear line.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.collectors._base import BaseCollector
from torchrl.weight_update import MultiProcessWeightSyncScheme

from xqmap import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError, WorkerLost
from xqmap.evaluation import SCENES_PER_TRAINING, training_scenes
from xqmap.models.policy import GreedyPolicy


def collector(cfg: DictConfig, env: ManiSkillEnv, policy: TensorDictModuleBase, made: int) -> BaseCollector:
    """What yields batches of decisions, as ``cfg.collector`` says.

    Args:
        cfg: validated settings.
        env: the simulator of this process, the one that ``collector=single`` steps.
        policy: greedy choice and exploration, as learned here.
        made: decisions made so far: workers start at scenes that no earlier decision can have reached.
    """
    settings = cfg.collector
    if settings.name == "single":
        return Collector(env, policy, frames_per_batch=settings.frames_per_batch, total_frames=-1, trust_policy=True)
    apart = SCENES_PER_TRAINING // settings.workers
    envs = [_Worker(build.make_env(cfg, training_scenes(cfg.seed) + i * apart + made)) for i in range(settings.workers)]
    policies = [partial(_policy, cfg, env.grid.pixel_size, i * apart + made) for i in range(settings.workers)]
    # Whole episodes, so that what is logged and learned never mixes two workers' decisions.
    whole = {"trajs_per_batch": settings.episodes_per_batch, "traj_format": "cat"}
    # The trainer ends the collection: to Ray, -1 would mean no frames at all.
    shared: dict[str, Any] = {"frames_per_batch": settings.frames_per_batch, "total_frames": 2**62, "trust_policy": True, "sync": False}
    if settings.name == "ray":
        if find_spec("ray") is None:
            raise UserError("collector=ray needs the package ray: pip install 'xqmap[ray]'")
        remote = {"num_cpus": 1, "num_gpus": 0}
        return Collector(
            envs, backend="ray", policy_factory=policies, collector_kwargs=[dict(whole) for _ in envs], remote_configs=remote, **shared
        )
    return Collector(
        envs,
        policy,
        backend="process",
        policy_factory=policies,
        # Not waiting for an answer: a worker that died would never give one.
        weight_sync_schemes={"policy": MultiProcessWeightSyncScheme(sync=False)},
        policy_device="cpu",
        **whole,
        **shared,
    )


def batches(source: BaseCollector) -> Iterator[TensorDictBase]:
    """The batches of ``source``.

    Raises:
        WorkerLost: if a worker came to an end.
    """
    try:
        yield from source
    except RuntimeError as error:
        raise WorkerLost(f"a worker process ended unexpectedly ({' '.join(str(error).split())[:200]})") from error


def share(source: BaseCollector, policy: TensorDictModuleBase) -> None:
    """Sends the present weights, and how far exploration has come, to the workers."""
    # A copy, since the next update may begin before it has arrived; in plain memory order, which is all that Ray's transport takes.
    weights = TensorDict.from_module(policy).data.cpu()
    source.update_policy_weights_(weights.apply(partial(torch.clone, memory_format=torch.contiguous_format)))


def close(source: BaseCollector, alone: bool) -> None:
    """Ends the workers; the simulator of this process (``alone``) stays open."""
    source.shutdown(**({"close_env": False} if alone else {}))


class _Worker:
    """Builds the environment where it is called. An interrupt at the keyboard reaches every process: the trainer alone answers it."""

    def __init__(self, make: Callable[[], ManiSkillEnv]) -> None:
        self.make = make

    def __call__(self) -> ManiSkillEnv:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        # The processors belong to the other workers and to the updates.
        os.environ.setdefault("LP_NUM_THREADS", "1")
        torch.set_num_threads(1)
        return self.make()


def _policy(cfg: DictConfig, pixel_size: float, seed: int) -> TensorDictModuleBase:
    """A worker's own copy of the policy, on its processor, with random numbers of its own."""
    cfg = cfg.copy()
    cfg.device = "cpu"
    exploration = build.exploration(cfg)
    exploration.generator.manual_seed((cfg.seed * SCENES_PER_TRAINING + seed) % 2**63)
    network = build.qmaps(cfg, pixel_size).to(memory_format=torch.contiguous_format)
    return TensorDictSequential(GreedyPolicy(network), exploration).requires_grad_(False)
