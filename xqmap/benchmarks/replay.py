"""What remembering costs: bytes for each decision, and seconds for a sample beside the update that learns from it."""

from __future__ import annotations

from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import TensorDict, TensorDictBase

from xqmap import keys
from xqmap.benchmarks.speed import BATCH, altered, alternating, deciding, goals, stepping
from xqmap.config import build
from xqmap.evaluation import play

# Two episodes of the tabletop that are cut short: what its states need at most.
DECISIONS = 60


def replay(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Sampling and turning 16 of the task's own transitions against the update, without next states (γ = 0) and with
    them.
    """
    torch.manual_seed(0)
    made, pixel_size = _played(cfg)
    found: dict[str, float] = {}
    for gamma in (0.0, 0.9):
        changed = altered(cfg, {"loss.gamma": gamma, "trainer.batch_size": BATCH})
        memory = build.replay(changed)
        memory.extend(made)
        batch = memory.sample()
        if not gamma:
            # Nothing follows: the update looks at no next state.
            batch["next", keys.TERMINATED] = torch.ones(BATCH, 1, dtype=torch.bool)
        network = build.qmaps(changed, pixel_size).cpu()
        step = stepping(changed, network, build.bf16(changed), TensorDict(batch.to_dict(), [BATCH]))
        sample, update = alternating(memory.sample, step, rounds=rounds)
        found |= {f"bytes/gamma={gamma:g}": memory.nbytes / len(memory), f"sample_s/gamma={gamma:g}": sample}
        found |= {f"update_s/gamma={gamma:g}": update, f"share/gamma={gamma:g}": sample / (sample + update)}
    most = {
        name: limit for name in found for part, limit in (("bytes", 300_000), ("share", 0.1)) if name.startswith(part)
    }
    return {**found, "decisions": len(made), "goals": goals(found, {}, most)}


def _played(cfg: DictConfig) -> tuple[TensorDictBase, float]:
    """Decisions ``[DECISIONS]`` at random pixels of the task, episode after episode, and the edge of its cells in
    metres.
    """
    world = build.make_env(cfg, first_scene=play.training_scenes(cfg.seed))()
    try:
        made = [step.clone() for step in deciding(world, DECISIONS)]
    finally:
        world.close()
    return torch.stack(made), world.grid.pixel_size
