"""One process left running: does it keep what it takes?"""

from __future__ import annotations

import gc
import math
import os
import statistics
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tqdm import tqdm

from xqmap import keys
from xqmap.config import build
from xqmap.envs.episode import episode
from xqmap.evaluation import play
from xqmap.models.policy import GreedyPolicy

# Decisions before memory counts as warmed up, as a share of all.
_WARM_UP = 0.2
# Where a process's handles of a GPU lead.
_DEVICES = ("/dev/nvidia", "/dev/dri")


def children() -> list[int]:
    """Processes that this one started and that are there still."""
    return [int(pid) for task in Path("/proc/self/task").glob("*/children") for pid in task.read_text().split()]


def resident() -> int:
    """Bytes of memory this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def held() -> dict[str, int]:
    """What this process holds: resident bytes, open files, those among them that are a graphics device, threads, child
    processes.
    """
    gc.collect()
    files = [os.readlink(file) for file in Path("/proc/self/fd").iterdir() if file.is_symlink()]
    return {
        "bytes": resident(),
        "files": len(files),
        "devices": sum(name.startswith(_DEVICES) for name in files),
        "threads": len(os.listdir("/proc/self/task")),
        "processes": len(children()),
    }


def _leaked(before: dict[str, int], after: dict[str, int]) -> dict[str, int]:
    """What is held more of, memory aside."""
    return {f"leaked_{name}": after[name] - before[name] for name in before if name != "bytes"}


def soak(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Decisions of an untrained policy with exploration in one world, then ten worlds opened and closed.

    Memory moves up and down by what is not yet collected: its ``growth`` is from the median of the third tenth of the
    decisions to that of the last.
    """
    torch.manual_seed(0)
    env = build.make_env(cfg, first_scene=play.training_scenes(cfg.seed))()
    policy, explore = GreedyPolicy(build.qmaps(cfg, env.grid.pixel_size)), build.exploration(cfg)
    warm, memory = held(), []

    def choose(state: TensorDictBase) -> int:
        with torch.no_grad():
            return int(explore(policy(state))[keys.ACTION])

    playing = chain.from_iterable(episode(env, choose) for _ in count())
    try:
        for made, _ in enumerate(tqdm(islice(playing, rounds), total=rounds, unit="decision", desc="soaking")):
            memory.append(resident())
            if made == int(_WARM_UP * rounds):
                warm = held()
        end = held()
    finally:
        env.close()
    tenth = math.ceil(rounds / 10)
    first, last = (statistics.median(part) for part in (memory[int(_WARM_UP * rounds) :][:tenth], memory[-tenth:]))
    result = {"decisions": rounds, "growth": last / first - 1, "mib": last / 2**20, "most_mib": max(memory) / 2**20}
    return result | _leaked(warm, end) | {f"reopened_{name}": value for name, value in reopen(cfg, 10).items()}


def reopen(cfg: DictConfig, times: int) -> dict[str, Any]:
    """Opens and closes the world that often; what is held more at the end than after the first half."""
    half = held()
    for i in tqdm(range(times), unit="world", desc="opening and closing"):
        env = build.make_env(cfg, first_scene=0)()
        env.reset()
        env.close()
        del env
        if i == times // 2 - 1:
            half = held()
    end = held()
    return {"growth": end["bytes"] / half["bytes"] - 1} | _leaked(half, end)
