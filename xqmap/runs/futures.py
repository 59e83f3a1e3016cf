"""Played futures: what really comes of each candidate of a decision, carried out in copies of its world."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tqdm import tqdm

from xqmap import keys
from xqmap.data.symmetry import elements
from xqmap.envs.episode import episode
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.explanations import Decision
from xqmap.models.policy import masked_argmax
from xqmap.runs.run import Run


def play(run: Run, decisions: Sequence[Decision], times: int) -> None:
    """Carries out every candidate of each decision, lets the policy go on to the end of the episode, and writes what
    was paid, discounted, into :attr:`~xqmap.explanations.Decision.played`.

    A world repeats itself exactly. From the second copy on the policy looks from one side of the map alone, where it
    decides on the mean over all of them: copies differ where its choices are narrow.

    Args:
        run: whose policy decided, and goes on.
        decisions: the successive decisions of one episode, from its beginning.
        times: copies of the world for each candidate.
    """
    env = run.make_env()
    plan = [
        (i, candidate, copy)
        for i, decision in enumerate(decisions)
        for candidate in decision.candidates
        for copy in range(times)
    ]
    try:
        for i, candidate, copy in tqdm(plan, unit="future", desc="playing", mininterval=1.0):
            decision = decisions[i]
            row, column = candidate.pixel or (0, 0)
            before = [env.cell(made) for made in decisions[:i]]
            env.next_scene = decision.scene_seed or 0
            came = _returns(run, env, [*before, row * env.grid.shape[1] + column], copy)
            weighed = zip(decision.components, came, run.policy.qmaps.weights.tolist(), strict=True)
            decision.played.setdefault(candidate.label, []).append({name: paid * w for name, paid, w in weighed})
    finally:
        env.close()


def _returns(run: Run, env: ManiSkillEnv, given: list[int], copy: int) -> list[float]:
    """``[K]``: what was paid from the last of the ``given`` actions on, discounted; the policy chooses all later
    ones.
    """
    made = 0

    def choose(state: TensorDictBase) -> int:
        nonlocal made
        made += 1
        return given[made - 1] if made <= len(given) else _greedy(run, state, copy)

    total, discount = torch.zeros(len(run.cfg.method.components), dtype=torch.float64), 1.0
    for step, result in enumerate(episode(env, choose), start=1):
        if step >= len(given):
            total += discount * result["next", run.cfg.method.reward_key].double()
            discount *= run.cfg.loss.gamma
    return total.tolist()


def _greedy(run: Run, state: TensorDictBase, copy: int) -> int:
    """The policy's choice; by a copy other than the first, from one side of the map."""
    qmaps, heightmap = run.policy.qmaps, state[keys.HEIGHTMAP]
    with torch.no_grad():
        if copy == 0 or not qmaps.symmetric:
            return int(run.policy(state.select(keys.HEIGHTMAP, keys.ACTION_MASK).clone())[keys.ACTION])
        side = (copy - 1) % elements(*heightmap.shape[-2:])
        total = (qmaps.from_side(heightmap[None], side)[0].flatten(1) * qmaps.weights[:, None]).sum(0)
    return int(masked_argmax(total, state[keys.ACTION_MASK]))
