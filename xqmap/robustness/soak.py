"""One process left running: does it keep what it takes?"""

from __future__ import annotations

import gc
import os
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

from xqmap import build, evaluation, keys
from xqmap.models.policy import GreedyPolicy

# Decisions before memory counts as warmed up, as a share of all.
_WARM_UP = 0.2
# Where a process's handles of a GPU lead.
_DEVICES = ("/dev/nvidia", "/dev/dri")


def children() -> list[int]:
    """Processes that this one started and that are there still."""
    return [int(pid) for task in Path("/proc/self/task").glob("*/children") for pid in task.read_text().split()]


def held() -> dict[str, int]:
    """What this process holds: resident bytes, open files, those among them that are a graphics device, threads, child processes."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    files = [os.readlink(file) for file in Path("/proc/self/fd").iterdir() if file.is_symlink()]
    return {
        "bytes": pages * os.sysconf("SC_PAGE_SIZE"),
        "files": len(files),
        "devices": sum(name.startswith(_DEVICES) for name in files),
        "threads": len(os.listdir("/proc/self/task")),
        "processes": len(children()),
    }


def _leaked(before: dict[str, int], after: dict[str, int]) -> dict[str, Any]:
    """How memory grew, as a share, and what is held more of all else."""
    more = {f"leaked_{name}": after[name] - before[name] for name in before if name != "bytes"}
    return {"growth": after["bytes"] / before["bytes"] - 1} | more


def soak(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Decisions of an untrained policy with exploration in one world, then ten worlds opened and closed."""
    torch.manual_seed(0)
    env = build.make_env(cfg, first_scene=evaluation.training_scenes(cfg.seed))()
    policy, explore = GreedyPolicy(build.qmaps(cfg, env.grid.pixel_size)), build.exploration(cfg)
    warm = held()
    try:
        state: TensorDictBase = env.reset()
        for made in tqdm(range(rounds), unit="decision", desc="soaking"):
            with torch.no_grad():
                state = env.step(explore(policy(state)))
            state = env.reset() if bool(state["next", keys.DONE]) else step_mdp(state)
            if made == int(_WARM_UP * rounds):
                warm = held()
        end = held()
    finally:
        env.close()
    result = {"decisions": rounds, "mib": end["bytes"] / 2**20} | _leaked(warm, end)
    return result | {f"reopened_{name}": value for name, value in reopen(cfg, 10).items()}


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
    return _leaked(half, held())
