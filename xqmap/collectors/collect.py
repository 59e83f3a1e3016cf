"""Who makes the decisions that training learns from: one simulator in this process, worker processes, or machines of a
Ray cluster.

What collects is torchrl's own; this file says which, and turns a worker's end into one clear line.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from multiprocessing import resource_tracker
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.collectors._base import BaseCollector
from torchrl.weight_update import MultiProcessWeightSyncScheme

from xqmap import keys
from xqmap.collectors import worker
from xqmap.config import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError, WorkerLost, brief
from xqmap.evaluation.play import SCENES_PER_TRAINING, training_scenes
from xqmap.terminal import pass_over_the_gone

# Seconds that workers may take to say that they have their new weights.
_PATIENCE = 60.0


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
        return Collector(env, policy, frames_per_batch=settings.frames_per_batch, **worker.ENDLESS)
    pass_over_the_gone()
    apart = SCENES_PER_TRAINING // settings.workers
    first = [i * apart + made for i in range(settings.workers)]
    practice = build.practice(cfg)
    makes = [build.make_env(practice, training_scenes(cfg.seed) + scene) for scene in first]
    policies = [partial(worker.policy, cfg, env.grid.pixel_size, scene) for scene in first]
    # Whole episodes, so that what is logged and learned never mixes two workers' decisions.
    whole = {"trajs_per_batch": settings.episodes_per_batch, "traj_format": "cat"}
    if settings.name == "ray":
        if find_spec("ray") is None:
            raise UserError("collector=ray needs the package ray: pip install 'xqmap[ray]'")
        from xqmap.collectors.cluster import Cluster  # which needs the package

        envs = [partial(worker.environment, make) for make in makes]
        source = Cluster(envs, policies, cfg.task.name, {"frames_per_batch": settings.frames_per_batch, **whole})
        share(source, policy)
        return source
    envs = [partial(worker.telling_environment, make) for make in makes]
    processes: dict[str, Any] = worker.ENDLESS | {
        "backend": "process",
        "policy_factory": policies,
        "policy_device": "cpu",
    }
    if settings.name == "ordered":
        synced = {"policy": _Acknowledged()}
        frames = settings.frames_per_batch * settings.workers
        return Collector(envs, policy, sync=True, frames_per_batch=frames, weight_sync_schemes=synced, **processes)
    processes |= {"frames_per_batch": settings.frames_per_batch, "sync": False}
    # Not waiting for an answer: a worker that died would never give one.
    synced = {"policy": _Unheard(sync=False)}
    return Collector(envs, policy, weight_sync_schemes=synced, **processes, **whole)


def outlive_the_terminal() -> None:
    """Starts the process in which multiprocessing keeps books of what its others share so that it hears neither Ctrl-C
    nor that the terminal is gone; to be called before anything else starts it, a first progress bar included.
    """
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP])
    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


class _Unheard(MultiProcessWeightSyncScheme):
    """Does not wait, at its end, until a worker has read what it was sent: one that died never will."""

    def shutdown(self) -> None:
        for queues in (self._weight_init_queues, self._instruction_queues, self._ack_queues):
            for queue in queues.values():
                queue.cancel_join_thread()
        super().shutdown()


class _Acknowledged(_Unheard):
    """Goes on when every worker has its new weights; or, if one has died and never will, when collecting finds that
    out.
    """

    def _wait_for_ack(self, worker_ids: int | list[int] | None = None, timeout: float | None = _PATIENCE) -> None:
        super()._wait_for_ack(worker_ids, timeout)


def batches(source: BaseCollector, settings: DictConfig) -> Iterator[TensorDictBase]:
    """The batches of ``source``, which :func:`collector` made of the same ``settings`` (``cfg.collector``).

    Raises:
        WorkerLost: if a worker came to an end.
    """
    if settings.name == "single":
        yield from source
        return
    try:
        yield from _in_order(source, settings.episodes_per_batch) if settings.name == "ordered" else source
    except UserError:
        raise
    except Exception as error:  # Ray's are of no common kind
        raise WorkerLost(f"a worker process ended unexpectedly ({brief(error)})") from error


def _in_order(source: BaseCollector, episodes: int) -> Iterator[TensorDictBase]:
    """Whole episodes by worker and time: torchrl numbers and sorts them by who came first."""
    ended: list[TensorDictBase] = []
    under_way: list[list[TensorDictBase]] = []
    for batch in source:
        under_way = under_way or [[] for _ in batch]
        for steps, episode in zip(batch.clone(), under_way, strict=True):
            for step in steps.split(1):
                episode.append(step)
                if bool(step["next", keys.DONE]):
                    ended.append(torch.cat(episode))
                    episode.clear()
        while len(ended) >= episodes:
            yield torch.cat(ended[:episodes])
            del ended[:episodes]


def share(source: BaseCollector, policy: TensorDictModuleBase) -> None:
    """Sends the present weights, and how far exploration has come, to the workers."""
    # A copy, since the next update may begin before it has arrived.
    source.update_policy_weights_(TensorDict.from_module(policy).data.cpu().clone())


def close(source: BaseCollector, alone: bool) -> None:
    """Ends the workers; the simulator of this process (``alone``) stays open."""
    source.shutdown(**({"close_env": False} if alone else {}))
