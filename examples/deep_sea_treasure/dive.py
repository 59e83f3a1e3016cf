"""Deep Sea Treasure (Vamplew et al. 2011) from MO-Gymnasium, through torchrl's own wrapper: a world with a vector of
rewards, solved by a small network with ``DecomposedDQNLoss``, held against exact values, and explained.

    pip install 'xqmap[examples]'
    python examples/deep_sea_treasure/dive.py
"""

from __future__ import annotations

import warnings

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.envs.libs.gym import MOGymEnv
from torchrl.modules import MLP
from torchrl.objectives import HardUpdate

from xqmap.explanations import Decision
from xqmap.objectives import DecomposedDQNLoss

COMPONENTS = ("treasure", "time")
ACTIONS = ("dive up", "dive down", "move left", "move right")
GAMMA = 0.95
SIDE = 11


def network() -> TensorDictSequential:
    """Writes the values ``[B, 2, 4]`` of a place ``[B, 2]`` (row, column), and their sum."""

    def seen(place: Tensor) -> Tensor:
        row, column = place.long().unbind(-1)
        return nn.functional.one_hot(SIDE * row + column, SIDE**2).float()

    mlp = MLP(in_features=SIDE**2, out_features=8, num_cells=[128], activation_class=nn.ReLU)
    return TensorDictSequential(
        TensorDictModule(seen, in_keys=["observation"], out_keys=["seen"]),
        TensorDictModule(nn.Sequential(mlp, nn.Unflatten(-1, (2, 4))), ["seen"], ["component_action_value"]),
        TensorDictModule(lambda parts: parts.sum(-2), ["component_action_value"], ["action_value"]),
    )


def experience(env: MOGymEnv, frames: int) -> TensorDictBase:
    """One transition of each kind that a diver meets who moves at random, mostly to the right, where it is deep."""
    chances = torch.tensor([0.15, 0.25, 0.15, 0.45])

    def at_random(place: Tensor) -> Tensor:
        return nn.functional.one_hot(chances.multinomial(1)[0], 4)

    policy = TensorDictModule(at_random, in_keys=["observation"], out_keys=["action"])
    made = env.rollout(frames, policy, break_when_any_done=False)
    # The sea always does the same, so once is enough of each.
    moves = torch.cat((made["observation"], made["action"]), -1)
    _, kinds = moves.unique(dim=0, return_inverse=True)
    return made[torch.stack([(kinds == kind).nonzero()[0, 0] for kind in range(int(kinds.max()) + 1)])]


def learned(batch: TensorDictBase, env: MOGymEnv, updates: int, shared_argmax: bool = True) -> DecomposedDQNLoss:
    """The loss after ``updates`` updates on the transitions of ``batch``."""
    loss = DecomposedDQNLoss(
        network(), components=COMPONENTS, shared_argmax=shared_argmax, loss_function="l2", action_space=env.action_spec
    )
    loss.set_keys(reward="reward")
    loss.make_value_estimator(gamma=GAMMA)
    target = HardUpdate(loss, value_network_update_interval=5)
    optimizer = torch.optim.Adam(loss.parameters(), lr=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    for _ in range(updates):
        losses = loss(batch)
        sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
        optimizer.step()
        optimizer.zero_grad()
        schedule.step()
        target.step()
    return loss


def exact(env: MOGymEnv) -> tuple[Tensor, Tensor]:
    """``[N, 2]`` and ``[N, 2, 4]``: the places that a diver can be in, the start first, and Q* there by value
    iteration, on what the world itself does.
    """
    world = env._env.unwrapped
    index, places, moves = {(0, 0): 0}, [(0, 0)], []
    # The list grows while it is gone through.
    for place in places:
        for action in range(4):
            world.reset()
            world.current_state = np.array(place, dtype=np.int32)
            seen, paid, terminated, _, _ = world.step(action)
            following = tuple(seen.tolist())
            if not terminated and following not in index:
                index[following] = len(places)
                places.append(following)
            moves.append((paid.tolist(), -1 if terminated else index[following]))
    reward = torch.tensor([paid for paid, _ in moves]).reshape(-1, 4, 2).mT
    following = torch.tensor([there for _, there in moves]).reshape(-1, 4)
    values = torch.zeros_like(reward)
    for _ in range(500):
        best = values.sum(1).argmax(-1)
        future = values[torch.arange(len(places)), :, best][following].movedim(-1, 1)
        values = reward + GAMMA * future.masked_fill((following < 0)[:, None], 0)
    return torch.tensor(places), values


def main(frames: int = 20000, updates: int = 2500) -> None:
    """Learns with one argmax for both components and, as the contrast, with one each (HRA); explains the start."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    env = MOGymEnv("deep-sea-treasure-v0")
    env.set_seed(0)
    batch = experience(env, frames)
    places, truth = exact(env)
    print(f"{frames} moves, {len(batch)} of the {4 * len(places)} kinds that there are")
    found = {}
    for method, shared in (("X-QMap", True), ("HRA", False)):
        loss = learned(batch, env, updates, shared)
        with torch.no_grad(), loss.value_network_params.to_module(loss.value_network):
            values = loss.value_network(TensorDict({"observation": places}, [len(places)]))["component_action_value"]
        error = (values - truth).abs().mean((0, 2))
        # Of equal moves any will do.
        gap = truth.sum(1).max(-1).values - truth.sum(1).gather(1, values.sum(1).argmax(-1, keepdim=True))[:, 0]
        right = float((gap < 1e-3).float().mean())
        print(
            f"{method}: best moves in {right:.1%} of the places; the bars of treasure and time are off by "
            f"{error[0]:.3f} and {error[1]:.3f}"
        )
        found[method] = values, error
    values, error = found["X-QMap"]
    decision = Decision.from_values(values[0], ACTIONS, COMPONENTS, errors=error.tolist(), task="deep-sea-treasure")
    print(f"\nAt the start:\n{decision.why()}\n\nHow sure are you?\n{decision.ask('How sure are you?')}")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
