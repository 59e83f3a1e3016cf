"""What can break while a training runs, injected on purpose: each must stop it in one line or let it go on, and cost no
byte.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from omegaconf import DictConfig, OmegaConf

from xqmap.benchmarks.robustness.interruptions import unharmed
from xqmap.benchmarks.robustness.soak import children
from xqmap.errors import UserError
from xqmap.runs import checkpoint
from xqmap.terminal import enduring
from xqmap.trainers.callbacks import Checkpoints, make_trainer
from xqmap.trainers.trainer import Trainer


class Fault(NamedTuple):
    """What is done to a training.

    Attributes:
        inject: does it to a trainer, at a decision.
        stops: whether that ends the training (in one line); None where it may as well come to its end before that is
            noticed.
        settings: of the training, where the fault needs others.
        repeats: whether the training, once it has gone on, must end with the weights of one that was left alone.
    """

    inject: Callable[[Trainer, int], Any]
    stops: bool | None
    settings: Mapping[str, Any] = {}
    repeats: bool = True


def _at_step(break_step: Callable[[Trainer, Callable[[Any], Any], Any], Any]) -> Callable[[Trainer, int], None]:
    """A fault of the world at one decision: ``break_step(trainer, step, action)`` stands in for the world's step."""

    def inject(trainer: Trainer, at: int) -> None:
        step, made = trainer.env.task.step, 0

        def broken(action: Any) -> Any:
            nonlocal made
            made += 1
            return break_step(trainer, step, action) if made == at else step(action)

        trainer.env.task.step = broken  # type: ignore[method-assign]

    return inject


def _throw(trainer: Trainer, step: Callable[[Any], Any], action: Any) -> Any:
    raise RuntimeError("the solver did not converge")


def _lose_device(trainer: Trainer, step: Callable[[Any], Any], action: Any) -> Any:
    raise RuntimeError("vk::Queue::submit: ErrorDeviceLost")


def _blind(trainer: Trainer, step: Callable[[Any], Any], action: Any) -> Any:
    # After the last step of an episode nobody looks, so the next first picture is dark as well.
    task, reset = trainer.env.task, trainer.env.task.reset

    def dark(observation: Any, *rest: Any) -> Any:
        for images in observation["sensor_data"].values():
            images["depth"] = torch.full_like(torch.as_tensor(images["depth"], dtype=torch.float32), float("nan"))
        return observation, *rest

    def reset_in_the_dark(*args: Any, **kwargs: Any) -> Any:
        task.reset = reset  # type: ignore[method-assign]
        return dark(*reset(*args, **kwargs))

    task.reset = reset_in_the_dark  # type: ignore[method-assign]
    return dark(*step(action))


def _void_reward(trainer: Trainer, step: Callable[[Any], Any], action: Any) -> Any:
    observation, reward, terminated, truncated, info = step(action)
    return observation, torch.as_tensor(reward) * float("nan"), terminated, truncated, info


def _hang(trainer: Trainer, at: int) -> None:
    make = trainer.env._decide
    made = 0

    def stuck(tensordict: Any) -> Any:
        nonlocal made
        made += 1
        if made == at - 1:
            trainer.env._limit = 1.0
        while made == at:
            time.sleep(0.01)
        return make(tensordict)

    trainer.env._decide = stuck  # type: ignore[method-assign]


def _sleep(trainer: Trainer, at: int) -> None:
    """A laptop's lid is closed in the middle of a decision, for longer than one may take."""
    make, made = trainer.env._decide, 0

    def asleep(tensordict: Any) -> Any:
        nonlocal made
        made += 1
        if made == at:
            trainer.env._limit = 1.0
            with subprocess.Popen(["sh", "-c", f"sleep 2.5; kill -CONT {os.getpid()}"]):
                os.kill(os.getpid(), signal.SIGSTOP)
        return make(tensordict)

    trainer.env._decide = asleep  # type: ignore[method-assign]


def _silence(trainer: Trainer, at: int) -> None:
    """Nothing that is printed can be written any more."""
    sys.stdout = sys.stderr = enduring(os.open("/dev/full", os.O_WRONLY), None)


def _void_loss(trainer: Trainer, at: int) -> None:
    update = trainer._update

    def spoiled() -> Any:
        if trainer.frames >= at:
            trainer.parameters[0].data.fill_(float("nan"))
        return update()

    trainer._update = spoiled  # type: ignore[method-assign]


def _at_decision(trainer: Trainer, at: int, act: Callable[[], Any]) -> None:
    """Has ``act`` happen once, when a batch with that decision has come and nothing was done with it yet."""
    step, done = trainer._step, False

    def then(batch: Any) -> Any:
        nonlocal done
        if not done and trainer.frames + len(batch) >= at:
            act()
            done = True
        return step(batch)

    trainer._step = then  # type: ignore[method-assign]


def _kill_worker(trainer: Trainer, at: int) -> None:
    # The others go on meanwhile, this one at the latest at its next decision.
    _at_decision(
        trainer, at, lambda: os.kill(next(p.pid for p in multiprocessing.active_children() if p.pid), signal.SIGKILL)
    )


def _kill_wandb(trainer: Trainer, at: int) -> None:
    def act() -> None:
        for pid in children():
            if b"wandb-core" in Path(f"/proc/{pid}/cmdline").read_bytes():
                os.kill(pid, signal.SIGKILL)

    _at_decision(trainer, at, act)


def _after_save(act: Callable[[Path], Any]) -> Callable[[Trainer, int], None]:
    def inject(trainer: Trainer, at: int) -> None:
        checkpoints = next(callback for callback in trainer.callbacks if isinstance(callback, Checkpoints))
        save = checkpoints.save

        def then(trainer: Trainer) -> None:
            save(trainer)
            act(trainer.directory)

        checkpoints.save = then  # type: ignore[method-assign]

    return inject


def _fill(directory: Path) -> None:
    # Not to the last byte: the next checkpoint shall begin and not end.
    with contextlib.suppress(OSError), open(directory / "filler", "wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 12))
    size = (directory / "filler").stat().st_size
    with open(directory / "filler", "r+b") as file:
        file.truncate(max(0, size - (1 << 15)))


FAULTS = {
    "simulator throws": Fault(_at_step(_throw), True),
    "graphics device lost": Fault(_at_step(_lose_device), True),
    "step never ends": Fault(_hang, True),
    "NaN in every depth": Fault(_at_step(_blind), True),
    "NaN in a reward": Fault(_at_step(_void_reward), True),
    "NaN in the loss": Fault(_void_loss, True),
    "worker killed": Fault(_kill_worker, None, {"collector": {"name": "parallel", "workers": 2}}, repeats=False),
    "terminal gone": Fault(
        lambda trainer, at: _at_decision(trainer, at, lambda: signal.raise_signal(signal.SIGHUP)), True
    ),
    "suspended in mid-decision": Fault(_sleep, False),
    "output that is full": Fault(_silence, False),
    "wandb killed": Fault(_kill_wandb, False, {"logger": {"mode": "offline"}}),
    "disk full": Fault(_after_save(_fill), True),
    "directory turns read-only": Fault(
        _after_save(lambda directory: _mount("--bind", directory, directory, read_only=True)), True
    ),
}
# These happen on a disk of the run's own, which only root can mount.
ON_A_DISK = ("disk full", "directory turns read-only")


def _mount(*arguments: Any, read_only: bool = False) -> None:
    done = subprocess.run(["mount", *map(str, arguments)], capture_output=True)
    if done.returncode != 0:
        raise PermissionError("mounting is not permitted here")
    if read_only:
        _mount("-o", "remount,ro,bind", arguments[-1])


@contextlib.contextmanager
def small_disk(directory: Path, megabytes: int) -> Iterator[None]:
    """Puts a disk in memory of that size at ``directory``, and takes it away at the end.

    Raises:
        PermissionError: if this user cannot mount.
    """
    directory.mkdir(parents=True)
    _mount("-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", directory)
    try:
        yield
    finally:
        mend(directory)
        subprocess.run(["umount", directory], check=True)


def mend(directory: Path) -> None:
    """Makes room on a full disk and a read-only directory writable again."""
    with contextlib.suppress(OSError):
        (directory / "filler").unlink(missing_ok=True)
    mounts = [line.split()[1] for line in Path("/proc/mounts").read_text().splitlines()]
    if mounts.count(str(directory)) > 1:
        subprocess.run(["umount", directory], check=True)


def suffer(cfg: DictConfig, directory: Path, fault: Fault) -> tuple[bool, int, str]:
    """Trains with the fault at half time, and goes on without it where it ended the training.

    Returns:
        Whether training stopped or went on as it should, with all files and every stored transition, and then came to
        its end; bytes lost; the line that was told.
    """
    directory.mkdir(parents=True, exist_ok=True)
    cfg = OmegaConf.merge(cfg, fault.settings)  # type: ignore[assignment]
    trainer, line = make_trainer(cfg, directory), ""
    streams = sys.stdout, sys.stderr
    fault.inject(trainer, cfg.trainer.frames // 2)
    try:
        trainer.run()
        line = f"stopped by signal {trainer.stopped_by}" if trainer.stopped_by else ""
    except (UserError, OSError) as error:
        line = str(error)
    finally:
        sys.stdout, sys.stderr = streams
        trainer.close()
    lost = unharmed(directory)
    mend(directory)
    whole = len(line.splitlines()) <= 1
    if line:
        saved = trainer.saved_frames
        trainer = make_trainer(cfg, directory, checkpoint.read_training(directory))
        whole = whole and len(trainer.replay) == min(saved, cfg.replay.capacity)
        trainer.run()
        trainer.close()
    return fault.stops in (None, bool(line)) and whole and trainer.frames >= cfg.trainer.frames and not lost, lost, line
