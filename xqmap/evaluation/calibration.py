"""Are the bars right? Component values against what is known: exact values of the world, and the returns that
followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from scipy.stats import spearmanr
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from xqmap import keys
from xqmap.envs.episode import episode
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Solvable
from xqmap.explanations.perception import Simulator

# Exact values that differ by no more are about the same: no sign of their difference is right or wrong.
ABOUT_THE_SAME = 0.05


def deviation(values: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    """How far ``values`` ``[N]`` are from ``truth`` ``[N]``.

    Returns:
        ``bias`` (mean of values − truth), ``mae``, ``rank_correlation`` (Spearman's; None where one side does not vary)
        and ``count``.
    """
    error = values - truth
    varies = len(values) > 1 and np.ptp(values) > 0 and np.ptp(truth) > 0
    return {
        "bias": float(error.mean()),
        "mae": float(np.abs(error).mean()),
        "rank_correlation": float(spearmanr(values, truth).statistic) if varies else None,
        "count": len(values),
    }


def right_signs(values: Sequence[np.ndarray], truth: Sequence[np.ndarray]) -> tuple[int, int]:
    """How often the sign of a difference Δ between two objects of one state is right: ``(right, asked)``.

    Args:
        values: of each state, ``[objects]``.
        truth: likewise; pairs whose truth differs by at most 0.05 are not asked about.
    """
    right = asked = 0
    for ours, exact in zip(values, truth, strict=True):
        first, second = np.triu_indices(len(exact), 1)
        expected = exact[first] - exact[second]
        differ = np.abs(expected) > ABOUT_THE_SAME
        right += int((np.sign(ours[first] - ours[second]) == np.sign(expected))[differ].sum())
        asked += int(differ.sum())
    return right, asked


def calibrate(
    policy: TensorDictModuleBase,
    env: ManiSkillEnv,
    seeds: Sequence[int],
    gamma: float,
    weights: Sequence[float],
    reward_key: str,
) -> dict[str, Any]:
    """Plays one whole episode per seed and compares along the way.

    In every state each object's values at its best cell (the one a policy would take it by) stand against the exact
    Q*_k of taking that object, where the world offers them (``Solvable``); the values at each chosen action stand
    against the discounted component returns that followed.

    Args:
        policy: greedy; writes ``component_action_value`` and ``action_value``.
        env: the world.
        seeds: of the scenes.
        gamma: the discount the policy was trained with.
        weights: w_k of the world's components, in their order.
        reward_key: ``reward_components``, or ``reward`` for a policy of the summed reward, which is held against Σ_k
            w_k Q*_k.

    Returns:
        ``{"gamma", "episodes", "exact": {component: …} or None, "returns": {component: …}}`` with :func:`deviation` of
        each component, in ``exact`` also ``sign_accuracy`` (None where no pair of objects differs) and the ``pairs``
        asked.
    """
    summed = np.array(weights, dtype=float)[:, None] if reward_key == keys.REWARD else np.eye(len(env.components))
    names = [keys.REWARD] if reward_key == keys.REWARD else list(env.components)
    ours, exact, chosen, returns = [], [], [], []
    for seed in tqdm(seeds, unit="episode", desc="calibrating", mininterval=1.0):
        env.next_scene = seed
        made: list[np.ndarray] = []

        def choose(state: TensorDictBase, made: list[np.ndarray] = made) -> int:
            with torch.no_grad():
                out = policy(state.select(keys.HEIGHTMAP, keys.ACTION_MASK).clone())
            truth = env.task.exact_values(gamma) if isinstance(env.task, Solvable) else None
            if truth is not None:
                values, there = _object_values(out, state[keys.HEIGHTMAP].numpy(), state[keys.ACTION_MASK].numpy(), env)
                ours.append(values)
                exact.append((np.asarray(truth, dtype=float) @ summed)[there])
            made.append(out[keys.CHOSEN_COMPONENT_VALUE].double().cpu().numpy())
            return int(out[keys.ACTION])

        paid = [decision["next", reward_key].double().numpy() for decision in episode(env, choose)]
        to_go = np.zeros(len(names))
        for value, reward in zip(reversed(made), reversed(paid), strict=True):
            to_go = reward + gamma * to_go
            chosen.append(value)
            returns.append(to_go)
    result: dict[str, Any] = {"gamma": gamma, "episodes": len(seeds), "exact": None}
    result["returns"] = {
        name: deviation(np.array(chosen)[:, k], np.array(returns)[:, k]) for k, name in enumerate(names)
    }
    if sum(map(len, ours)):
        result["exact"] = {}
        for k, name in enumerate(names):
            right, asked = right_signs([v[:, k] for v in ours], [t[:, k] for t in exact])
            signs = {"sign_accuracy": right / asked if asked else None, "pairs": asked}
            result["exact"][name] = deviation(np.concatenate(ours)[:, k], np.concatenate(exact)[:, k]) | signs
    return result


def _object_values(
    out: Any, heightmap: np.ndarray, mask: np.ndarray, env: ManiSkillEnv
) -> tuple[np.ndarray, list[int]]:
    """The component values at each object's best allowed cell, ``[objects, K]``, and which objects have one."""
    scene, things = Simulator()(heightmap, env.grid, env.task), env.task.scene_objects()
    maps, total = out[keys.COMPONENT_ACTION_VALUE].double().cpu().numpy(), out[keys.ACTION_VALUE].double().cpu().numpy()
    values, there = [], []
    # The perception has the objects by rising height, so that what lies on top covers what is below.
    for index, thing in enumerate(sorted(range(len(things)), key=lambda i: things[i].top)):
        cells = np.flatnonzero((scene.cells.reshape(-1) == index) & mask)
        if len(cells):
            values.append(maps[:, cells[total[cells].argmax()]])
            there.append(thing)
    return np.array(values).reshape(len(there), len(maps)), there


def table(result: dict[str, Any]) -> str:
    """What :func:`calibrate` found, as the lines a person reads."""
    lines = [f"Q-Maps against what is known, {result['episodes']} episodes, γ = {result['gamma']:g}"]
    lines.append(f"{'':<30}{'bias':>8}{'abs. error':>12}{'rank corr.':>12}{'Δ sign right':>14}{'count':>8}")
    for title, part in (("exact value", result["exact"]), ("return that followed", result["returns"])):
        for name, row in (part or {}).items():
            rank, sign = row["rank_correlation"], row.get("sign_accuracy")
            rates = f"{'–' if rank is None else f'{rank:.2f}':>12}{'–' if sign is None else f'{sign:.1%}':>14}"
            lines.append(f"{f'{name}, {title}':<30}{row['bias']:>+8.3f}{row['mae']:>12.3f}{rates}{row['count']:>8}")
    if result["exact"] is None:
        lines.append("no exact values: this world cannot be solved exactly as it is set up")
    return "\n".join(lines)
