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


def held() -> dict[str, int]:
    """What this process holds: resident bytes, open files, threads, child processes."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    children = sum(len(task.read_text().split()) for task in Path("/proc/self/task").glob("*/children"))
    return {
        "bytes": pages * os.sysconf("SC_PAGE_SIZE"),
        "files": len(os.listdir("/proc/self/fd")),
        "threads": len(os.listdir("/proc/self/task")),
        "processes": children,
    }


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
    result: dict[str, Any] = {"decisions": rounds, "growth": end["bytes"] / warm["bytes"] - 1, "mib": end["bytes"] / 2**20}
    result |= {f"leaked_{name}": end[name] - warm[name] for name in ("files", "threads", "processes")}
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
    end = held()
    return {"growth": end["bytes"] / half["bytes"] - 1} | {f"leaked_{n}": end[n] - half[n] for n in ("files", "threads", "processes")}
