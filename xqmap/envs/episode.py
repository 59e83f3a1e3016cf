"""The one loop that plays: state, choice, what came of it, next state."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from xqmap import keys


def episode(env: EnvBase, choose: Callable[[TensorDictBase], int | None]) -> Iterator[TensorDictBase]:
    """Plays an episode from a new scene on.

    Args:
        env: the world.
        choose: takes the state (``heightmap``, ``action_mask``), returns the cell; None ends the episode there, and
            nothing is carried out.

    Yields:
        The state with its ``action``, and under ``next`` what came of it.
    """
    state, done = env.reset(), False
    while not done and (action := choose(state)) is not None:
        state[keys.ACTION] = torch.tensor(action)
        state = env.step(state)
        done = bool(state["next", keys.DONE])
        yield state
        state = step_mdp(state)
