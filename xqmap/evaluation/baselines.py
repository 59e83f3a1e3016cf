"""What picks a cell: a policy, and the baselines it is held against."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from xqmap import keys
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.envs.protocol import Advised
from xqmap.models.policy import GreedyPolicy, random_action

Chooser = Callable[[TensorDictBase, ManiSkillEnv, torch.Generator], int]


def greedy(policy: TensorDictModuleBase) -> Chooser:
    """The policy's own choice."""

    def choose(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
        with torch.no_grad():
            return int(policy(state.select(keys.HEIGHTMAP, keys.ACTION_MASK))[keys.ACTION])

    return choose


def out_of_context(policy: GreedyPolicy) -> Chooser:
    """The policy's choice when its context says nothing: a control, of which no more can be expected than of someone
    who looks at one object at a time.
    """
    blind = copy.deepcopy(policy)
    for parameter in blind.qmaps.context.numbers.parameters():
        parameter.data.zero_()
    return greedy(blind)


def random_pixel(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
    """Any allowed cell."""
    return int(random_action(state[keys.HEIGHTMAP][3].flatten(), state[keys.ACTION_MASK], None, generator))


def random_object(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
    """The middle of a random object, as the world knows it; any cell where there is no object."""
    (x0, x1), (y0, y1), _ = env.grid.bounds
    centres = [np.asarray(thing.footprint).mean(0) for thing in env.task.scene_objects()]
    inside = [centre for centre in centres if x0 <= centre[0] < x1 and y0 <= centre[1] < y1]
    if not inside:
        return random_pixel(state, env, generator)
    return env.action_at(inside[int(torch.randint(len(inside), (), generator=generator))])


def highest_cell(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
    """The highest allowed cell."""
    return int(state[keys.HEIGHTMAP][3].flatten().masked_fill(~state[keys.ACTION_MASK], -torch.inf).argmax())


def oracle(state: TensorDictBase, env: ManiSkillEnv, generator: torch.Generator) -> int:
    """The cell of the world's own best point."""
    return env.action_at(env.task.oracle_point())


BASELINES: dict[str, Chooser] = {
    "random pixel": random_pixel,
    "random object": random_object,
    "highest cell": highest_cell,
    "oracle": oracle,
}


def known_to(env: ManiSkillEnv, gamma: float) -> dict[str, Chooser]:
    """The baselines of a world: the usual ones, and, where something follows, its own advisers."""
    if gamma == 0 or not isinstance(env.task, Advised):
        return BASELINES

    def advised(name: str) -> Chooser:
        return lambda state, env, generator: env.action_at(env.task.advice(name, gamma))  # type: ignore[attr-defined]

    return BASELINES | {name: advised(name) for name in env.task.ADVISERS}
