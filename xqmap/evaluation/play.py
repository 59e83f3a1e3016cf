"""Plays a policy on scenes nobody trained on, and counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any

import numpy as np
import torch
from matplotlib.path import Path as Outline
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tqdm import tqdm

from xqmap import keys
from xqmap.envs.episode import episode
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Solvable
from xqmap.evaluation.baselines import Chooser, greedy, known_to, out_of_context
from xqmap.evaluation.optimum import Optimum
from xqmap.evaluation.statistics import success
from xqmap.models.policy import GreedyPolicy

# Scenes of one run are this far apart, so that seeds 0 … 9999 never share one; training starts at TRAINING_SCENES.
SCENES_APART = 10_000
TRAINING_SCENES = 1_000_000_000
SCENES_PER_TRAINING = 1_000_000
# Two rewards that differ by less are the same.
SAME_REWARD = 1e-4


def training_scenes(seed: int) -> int:
    """The first scene of a training with this seed: no evaluation scene, and none of another training's."""
    return TRAINING_SCENES + seed * SCENES_PER_TRAINING


def object_at(point: Any, things: Iterable[Any], background: str) -> str:
    """The name of the highest of the world's objects (``SceneObject``) at a point ``[≥2]`` (m), or of the
    background.
    """
    x, y = float(point[0]), float(point[1])
    here = [thing for thing in things if Outline(np.asarray(thing.footprint)).contains_point((x, y))]
    return max(here, key=lambda thing: thing.top).name if here else background


def play(
    choose: Chooser,
    env: ManiSkillEnv,
    seed: int,
    choices: int,
    until: dict[str, float] | None,
    confusion: Counter[tuple[str, str]] | None = None,
    optimum: Optimum | None = None,
) -> dict[str, Any]:
    """One evaluation run: scene after scene until the choices are made or a sub-reward has summed up.

    Args:
        choose: picks the cell.
        env: the world; its scenes are set here.
        seed: of the run; scene i has the seed ``seed + 10000 · i``.
        choices: the most choices.
        until: sums of sub-rewards, by component, any of which ends the run; None for no such end.
        confusion: counts, where given, the (object chosen, object best) of each choice. A choice of the highest reward
            is its own best; otherwise the best is what the world's oracle would have taken.
        optimum: holds, where given, each choice against Q*; its numbers are the run's, too.

    Returns:
        ``{"seed", "choices", "correct", "regret", "components": {name: mean}}``: a choice is correct when its reward is
        the highest available in that state; regret is the mean of highest available − taken.
    """
    generator = torch.Generator().manual_seed(seed)
    until = until or {}
    sums = torch.zeros(len(env.components))
    correct, regret, made, scene = 0, 0.0, 0, seed
    names: tuple[str, str] | None = None
    first = True

    def looked_at(state: TensorDictBase) -> int:
        nonlocal names, first
        if first and optimum is not None:
            optimum.begin()
        first = False
        action = choose(state, env, generator)
        names = _chosen_and_best(env, action) if confusion is not None else None
        return action

    while made < choices:
        env.next_scene, scene, first = scene, scene + SCENES_APART, True
        for decision in islice(episode(env, looked_at), choices - made):
            result = decision["next"]
            if optimum is not None:
                optimum.add(result)
            gap = float(result[keys.REWARD_AVAILABLE] - result[keys.REWARD])
            correct, regret, made = correct + (gap < SAME_REWARD), regret + gap, made + 1
            if confusion is not None and names is not None:
                confusion[names[0], names[0] if gap < SAME_REWARD else names[1]] += 1
            sums += result[keys.REWARD_COMPONENTS]
            if any(float(sums[env.components.index(name)]) >= total - SAME_REWARD for name, total in until.items()):
                choices = made
                break
    components = {name: float(total) / max(1, made) for name, total in zip(env.components, sums, strict=True)}
    return {
        "seed": seed,
        "choices": made,
        "correct": correct,
        "regret": regret / max(1, made),
        "components": components,
        **(optimum.found() if optimum is not None else {}),
    }


def _chosen_and_best(env: ManiSkillEnv, action: int) -> tuple[str, str]:
    things, background = env.task.scene_objects(), env.task.BACKGROUND
    chosen, best = (object_at(point, things, background) for point in (env.point(action), env.task.oracle_point()))
    return chosen, best


def evaluate(
    policy: TensorDictModuleBase,
    env: ManiSkillEnv,
    seeds: list[int],
    choices: int,
    until: dict[str, float] | None,
    baselines: bool,
    gamma: float = 0.0,
    weights: Sequence[float] = (),
    controls: bool = False,
) -> dict[str, Any]:
    """The policy and, where asked for, the baselines on the same scenes.

    Where something follows (γ > 0) and the world can be solved, choices are held against Q* as well, and who the world
    offers as advisers (:class:`~xqmap.envs.protocol.Advised`) plays, too.

    Args:
        policy: writes ``action``.
        env: the world.
        seeds: of the runs.
        choices: the most choices of a run.
        until: see :func:`play`.
        baselines: whether the baselines play.
        gamma: discount per decision that the policy was trained with.
        weights: w_k of the world's components, in their order; read only where choices are held against Q*.
        controls: whether a policy with a context is also played without it.

    Returns:
        The part of ``evaluation.json`` that playing decides: ``runs``, ``success``, ``confusion`` (of the policy:
        ``{chosen: {best: count}}``), ``controls``, ``baselines``.
    """
    own = {"policy": greedy(policy)}
    if controls and isinstance(policy, GreedyPolicy) and policy.qmaps.context is not None:
        own["out of context"] = out_of_context(policy)
    choosers = own | (known_to(env, gamma) if baselines else {})
    solved = gamma > 0 and isinstance(env.task, Solvable)
    table: dict[str, list[dict[str, Any]]] = {}
    pairs: Counter[tuple[str, str]] = Counter()
    with tqdm(total=len(choosers) * len(seeds), unit="run", desc="evaluating", mininterval=1.0) as bar:
        for name, choose in choosers.items():
            table[name] = []
            bar.set_postfix_str(name)
            for seed in seeds:
                optimum = Optimum(env, gamma, weights) if solved else None
                counted = pairs if name == "policy" else None
                table[name].append(play(choose, env, seed, choices, until, counted, optimum))
                bar.update()
    return {
        "runs": table["policy"],
        "success": success(table["policy"]),
        **against_optimum(table["policy"]),
        "confusion": {
            chosen: {b: n for (c, b), n in sorted(pairs.items()) if c == chosen}
            for chosen in sorted({c for c, _ in pairs})
        },
        **({"controls": {name: _row(table[name]) for name in own if name != "policy"}} if len(own) > 1 else {}),
        "baselines": {name: _row(runs) for name, runs in table.items() if name not in own},
    }


def _row(runs: list[dict[str, Any]]) -> dict[str, Any]:
    return success(runs) | {"regret": _mean_regret(runs)} | against_optimum(runs)


def _mean_regret(runs: list[dict[str, Any]]) -> float:
    return sum(run["regret"] * run["choices"] for run in runs) / max(1, sum(run["choices"] for run in runs))


def against_optimum(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Of runs that were held against Q*: ``optimal``, the choices that it calls best, counted as
    :func:`~xqmap.evaluation.statistics.success` counts, and ``return_ratio``, return over optimum.
    """
    asked = [{"choices": run["asked"], "correct": run["optimal"]} for run in runs if run.get("asked")]
    got, most = (sum(run.get(name, 0.0) for run in runs) for name in ("return", "optimum"))
    return ({"optimal": success(asked)} if asked else {}) | ({"return_ratio": got / most} if most else {})


def table(result: dict[str, Any]) -> str:
    """``evaluation.json`` as the lines a person reads."""
    own = against_optimum(result["runs"])
    rows = [(result["method"], result["success"] | own, _mean_regret(result["runs"]))]
    others = result.get("controls", {}) | result["baselines"]
    rows += [(name, row, row["regret"]) for name, row in others.items()]
    further = {name: head for name, head in (("optimal", "best by Q*"), ("return_ratio", "÷ optimum")) if name in own}
    lines = [f"{result['task']}: best choices ÷ choices on {len(result['runs'])} seeds never trained on"]
    lines.append(f"{'':<15}{'best choices':>14}{'± over runs':>13}{'95 % interval':>19}{'choices':>9}{'regret':>9}")
    lines[-1] += "".join(f"{head:>12}" for head in further.values())
    for name, row, regret in rows:
        low, high = row["ci95"]
        lines.append(
            f"{name:<15}{row['mean']:>13.1%} "
            f"{row['std']:>12.1%}{f'{low:.1%} – {high:.1%}':>19}{row['choices']:>9}{regret:>9.3f}"
            + "".join(_share(row.get(name)) for name in further)
        )
    return "\n".join(lines)


def _share(found: Any) -> str:
    if found is None:
        return f"{'':>12}"
    return f"{found['mean'] if isinstance(found, dict) else found:>12.1%}"
