"""Trainings that are killed and go on: in a process of their own, at random moments and while a checkpoint is being
written.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import random
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from xqmap.config import schema
from xqmap.runs import checkpoint
from xqmap.trainers.callbacks import make_trainer

# Where in the writing of a file the process dies: half of it is there, all of it under its working name, all of it in
# its place.
STAGES = ("half", "whole", "moved")
# A checkpoint's files, in the order they are written.
FILES = ("policy", "best", "training")
SABOTAGES = tuple((stage, file) for stage in STAGES for file in FILES)


def attempt(settings: dict[str, Any], directory: str, sabotage: tuple[str, str] | None = None) -> None:
    """Trains in ``directory``, or goes on there, to the end, in this process.

    Args:
        settings: a training's, as plain values.
        directory: the run directory.
        sabotage: stage and file of a checkpoint at which this process kills itself; None lets it be.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    place = Path(directory)
    place.mkdir(parents=True, exist_ok=True)
    if sabotage is not None:
        _die_at(*sabotage)
    with open(place.with_suffix(".log"), "a") as log, contextlib.redirect_stderr(log):
        saved = checkpoint.read_training(place) if checkpoint.trainings(place) else None
        cfg = schema.typed(OmegaConf.create(settings))
        trainer = make_trainer(cfg, place, saved)
        trainer.run()
        trainer.close()


def _die_at(stage: str, file: str) -> None:
    replace = os.replace

    def replaced(source: Any, target: Any) -> None:
        if not (Path(target).name.startswith(file) and Path(target).suffix == ".safetensors"):
            replace(source, target)
            return
        if stage == "half":
            os.truncate(source, os.stat(source).st_size // 2)
        if stage == "moved":
            replace(source, target)
        os.kill(os.getpid(), signal.SIGKILL)

    os.replace = replaced  # type: ignore[assignment]


@contextlib.contextmanager
def training(cfg: DictConfig, directory: Path, sabotage: tuple[str, str] | None = None) -> Iterator[BaseProcess]:
    """A process that runs :func:`attempt`; killed at the latest when the block ends."""
    context = multiprocessing.get_context("forkserver")
    # Imported once, in a process without threads that the attempts are forked from.
    context.set_forkserver_preload(["xqmap.trainers.callbacks", "xqmap.benchmarks.robustness.interruptions"])
    settings = OmegaConf.to_container(cfg, resolve=True)
    process = context.Process(target=attempt, args=(settings, str(directory), sabotage))
    process.start()
    try:
        yield process
    finally:
        process.kill()
        process.join()


def finish(cfg: DictConfig, directory: Path) -> tuple[str, float]:
    """Trains to the end without harm; returns the weights' SHA-256 and the seconds from its first decisions to the end.

    Raises:
        RuntimeError: if the process failed.
    """
    with training(cfg, directory) as process:
        while process.is_alive() and not _rows(directory):
            time.sleep(0.005)
        start = time.perf_counter()
        process.join()
        if process.exitcode != 0:
            log = directory.with_suffix(".log").read_text().splitlines()[-1:]
            raise RuntimeError(f"a training in {directory} ended with {process.exitcode}: {log}")
    return checkpoint.read(directory / checkpoint.POLICY)[1]["sha256"], time.perf_counter() - start


def _rows(directory: Path) -> int:
    path = directory / "metrics.csv"
    return path.read_bytes().count(b"\n") if path.exists() else 0


def kill_at_random(cfg: DictConfig, directory: Path, rng: random.Random, seconds: float) -> bool:
    """Lets a training go on until it has made its next decisions, and kills it up to ``seconds`` later; False if it
    ended before.
    """
    with training(cfg, directory) as process:
        before = _rows(directory)
        while process.is_alive() and _rows(directory) <= max(1, before):
            time.sleep(0.005)
        process.join(rng.uniform(0, seconds))
        return process.exitcode is None


def unharmed(directory: Path) -> int:
    """Bytes of files under their final names that do not read back whole: 0, if writing is atomic."""
    lost = 0
    for path in (directory / checkpoint.POLICY).parent.glob("[!.]*.safetensors"):
        try:
            checkpoint.read(path)
        except Exception:
            lost += path.stat().st_size
    return lost


def interrupt(
    cfg: DictConfig, folder: Path, kills: int, sabotages: Sequence[tuple[str, str]] = SABOTAGES, seed: int = 0
) -> dict[str, Any]:
    """Kills trainings at random moments and while they write, and compares how they end.

    Args:
        cfg: of the training.
        folder: where the runs are left.
        kills: at random moments.
        sabotages: stages and files of a checkpoint in whose writing a training dies.
        seed: of the moments.

    Returns:
        ``injected``; ``survived``: no file was harmed and the weights at the end are those of a run left alone;
        ``bytes_lost`` in harmed files; how many ``runs`` there were and how many ``ended_alike``.
    """
    rng = random.Random(seed)
    expected, seconds = finish(cfg, folder / "alone")
    done = survived = lost = runs = alike = 0

    def end(directory: Path, clean: int) -> None:
        nonlocal runs, alike, survived
        same = finish(cfg, directory)[0] == expected
        runs, alike, survived = runs + 1, alike + same, survived + clean * same

    with tqdm(total=kills + len(sabotages), unit="kill", desc="killing") as bar:

        def chain(directory: Path, kill: Callable[[int], bool], most: int) -> int:
            nonlocal done, lost
            clean = count = 0
            while count < most and kill(count):
                harm = unharmed(directory)
                lost, clean, count = lost + harm, clean + (harm == 0), count + 1
                bar.update()
            done += count
            end(directory, clean)
            return count

        def sabotaged(count: int) -> bool:
            with training(cfg, folder / "written", sabotages[count]) as process:
                process.join()
                return process.exitcode == -signal.SIGKILL

        chain(folder / "written", sabotaged, len(sabotages))
        left = kills
        while left:
            directory = folder / f"killed{runs}"
            left -= chain(directory, lambda _, at=directory: kill_at_random(cfg, at, rng, seconds / 2), left)  # type: ignore[misc]
    return {"injected": done, "survived": survived, "bytes_lost": lost, "runs": runs, "ended_alike": alike}
