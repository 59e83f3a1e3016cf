"""What a worker's process holds: a simulator and a policy of its own."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential

from xqmap.config import build
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.evaluation.play import SCENES_PER_TRAINING
from xqmap.models.policy import GreedyPolicy
from xqmap.terminal import endure, one_line, pass_over_the_gone, say

# What every collector of torchrl's is told: the trainer ends the collection; the policy is our own, and needs no
# transform that torchrl would add.
ENDLESS: dict[str, Any] = {"total_frames": -1, "trust_policy": True, "auto_register_policy_transforms": False}


def environment(make: Callable[[], ManiSkillEnv]) -> ManiSkillEnv:
    """Builds the environment here, in a worker. Ctrl-C and the end of the terminal reach every process: the trainer
    alone answers them.
    """
    endure()
    pass_over_the_gone()
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # The processors belong to the other workers and to the updates.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    torch.set_num_threads(1)
    return make()


def telling_environment(make: Callable[[], ManiSkillEnv]) -> ManiSkillEnv:
    """The same. What fails there is told there, in one line, and ends the process: raised, torchrl would tell it with
    all its stacks.
    """
    env = environment(make)
    for name in ("_reset", "_step"):
        setattr(env, name, partial(_or_end, getattr(env, name)))
    return env


def _or_end(act: Callable[..., TensorDictBase], *args: Any, **kwargs: Any) -> TensorDictBase:
    try:
        return act(*args, **kwargs)
    except UserError as error:
        say(one_line(f"error in a worker: {error}"), to=sys.stderr)
        os._exit(1)


def policy(cfg: DictConfig, pixel_size: float, seed: int) -> TensorDictModuleBase:
    """A worker's own copy of the policy, on its processor, with random numbers of its own."""
    cfg = cfg.copy()
    cfg.device = "cpu"
    exploration = build.exploration(cfg)
    exploration.generator.manual_seed((cfg.seed * SCENES_PER_TRAINING + seed) % 2**63)
    network = build.qmaps(cfg, pixel_size)
    return TensorDictSequential(GreedyPolicy(network), exploration).requires_grad_(False)
