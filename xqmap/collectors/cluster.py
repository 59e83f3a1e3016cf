"""Workers on the machines of a Ray cluster: each is one actor and takes one of the cluster's CPUs.

``RAY_ADDRESS`` names the cluster, which is left as it was found. Without one a cluster of this machine alone is
started, and ended with the training.
"""

from __future__ import annotations

import contextlib
import logging
import os
import platform
import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ray
from ray.exceptions import RayActorError, RayError, RayTaskError
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector

from xqmap.collectors.worker import ENDLESS
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError, WorkerLost, brief
from xqmap.terminal import say

MakeEnv = Callable[[], ManiSkillEnv]
MakePolicy = Callable[[], TensorDictModuleBase]


@dataclass
class Place:
    """Where a worker runs: its machine's name, its process there, and the file that has what it says."""

    machine: str
    process: int
    log: str


class Cluster:
    """Yields what the workers of a Ray cluster collect, from whichever has it first.

    Args:
        envs: what builds each worker's environment, there.
        policies: what builds each worker's policy, there.
        task: what they run, by name.
        settings: of the collector (torchrl's) that each worker holds.

    Raises:
        UserError: if there is no cluster, if it is too small, or if a worker does not start.
    """

    def __init__(
        self, envs: Sequence[MakeEnv], policies: Sequence[MakePolicy], task: str, settings: Mapping[str, Any]
    ) -> None:
        self.workers: list[Any] = []
        self.places: list[Place] = []
        self._found = ray.is_initialized()
        try:
            if not self._found:
                _join(len(envs))
            _require(len(envs))
            actor: Any = ray.remote(num_cpus=1, max_restarts=0)(_Worker)
            self.workers = [actor.remote() for _ in envs]
            makes = zip(self.workers, envs, policies, strict=True)
            starting = [worker.start.remote(env, policy, settings) for worker, env, policy in makes]
            for number, place in enumerate(starting):
                self.places.append(self._get(place, number))
                say(f"{self._named(number)} runs {task}", to=sys.stderr)
        except BaseException:
            self.shutdown()
            raise

    def __iter__(self) -> Iterator[TensorDictBase]:
        pending = {worker.next.remote(): number for number, worker in enumerate(self.workers)}
        while True:
            (first,), _ = ray.wait(list(pending))
            number = pending.pop(first)
            batch = self._get(first, number)
            # It goes on meanwhile, with slightly older weights.
            pending[self.workers[number].next.remote()] = number
            yield batch

    def update_policy_weights_(self, weights: TensorDictBase) -> None:
        """Sends each worker the weights, for its next batch; waits for none, since one may have died."""
        stored = ray.put(weights)
        for worker in self.workers:
            worker.learn.remote(stored)

    def shutdown(self) -> None:
        """Ends the workers, and the cluster if it was started here."""
        while self.workers:
            with contextlib.suppress(Exception):  # it may be gone, with its machine
                ray.kill(self.workers.pop())
        if not self._found:
            ray.shutdown()

    def _get(self, answer: Any, number: int) -> Any:
        try:
            return ray.get(answer)
        except RayTaskError as error:
            cause = error.cause
            why = brief(cause) if isinstance(cause, UserError) else f"{type(cause).__name__}: {brief(cause)}"
            raise WorkerLost(f"{self._named(number)} failed ({why}){self._log(number)}") from error
        except RayError as error:
            # Of a process that ended Ray says at length what may have been the reason, and does not know it.
            why = "" if isinstance(error, RayActorError) else f" ({brief(error)})"
            raise WorkerLost(f"{self._named(number)} ended unexpectedly{why}{self._log(number)}") from error

    def _named(self, number: int) -> str:
        who = f"worker {number + 1} of {len(self.workers)}"
        if number >= len(self.places):
            return who
        return f"{who} (machine {self.places[number].machine}, process {self.places[number].process})"

    def _log(self, number: int) -> str:
        return f"; what it said is in its machine's {self.places[number].log}" if number < len(self.places) else ""


class _Worker:
    """Collects where Ray puts it. It builds nothing before it is told to, so that what fails then can be told."""

    weights: TensorDictBase | None = None

    def start(self, env: MakeEnv, policy: MakePolicy, settings: Mapping[str, Any]) -> Place:
        """Builds everything; returns where that is."""
        self.policy = policy()
        self.batches = iter(Collector(env(), self.policy, **ENDLESS, **settings))
        return Place(platform.node(), os.getpid(), os.readlink("/proc/self/fd/2"))

    def next(self) -> TensorDictBase:
        """The next batch, with the newest weights."""
        try:
            if self.weights is not None:
                TensorDict.from_module(self.policy).data.update_(self.weights)
                self.weights = None
            return next(self.batches)
        except Exception:
            # In its log; the trainer gets the last line of it.
            say(traceback.format_exc(), to=sys.stderr)
            raise

    def learn(self, weights: TensorDictBase) -> None:
        """Takes weights, for the next batch: what is wrong with them is told with that."""
        self.weights = weights


def _join(workers: int) -> None:
    """Joins the cluster that ``RAY_ADDRESS`` names, or starts one that has a CPU for each worker."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    # What it says of a worker's end, in many lines, comes past both settings.
    ray._private.worker._worker_logs_enabled = False
    address = os.environ.get("RAY_ADDRESS")
    handler = signal.getsignal(signal.SIGTERM)
    # What it starts outlives the terminal, as the trainer does until it has saved.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGHUP])
    try:
        if address:
            ray.init(address, **quiet)
        else:
            ray.init("local", num_cpus=workers, include_dashboard=False, **quiet)
    except Exception as error:  # of no common kind
        fix = "see what Ray says above, or in /tmp/ray"
        if address:
            fix = f"see that one answers at RAY_ADDRESS={address}, and that RAY_AUTH_MODE and the token are its own"
        raise UserError(f"collector=ray: no cluster ({brief(error)}): {fix}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        # It has taken it for itself.
        signal.signal(signal.SIGTERM, handler)


def _require(workers: int) -> None:
    """Sees that the cluster has enough CPUs, and says if they are not free yet."""
    there, free = (int(found().get("CPU", 0)) for found in (ray.cluster_resources, ray.available_resources))
    if there < workers:
        raise UserError(
            f"collector.workers={workers}, but the Ray cluster has {there} CPUs, one for each worker: let another "
            f"machine join it, or give collector.workers={there}"
        )
    if free < workers:
        say(f"waiting for {workers} CPUs of the Ray cluster, {free} of {there} are free", to=sys.stderr)
