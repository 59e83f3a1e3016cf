"""CliffWorld, as in "Explainable Reinforcement Learning via Reward Decomposition" (Juozapaitis et al. 2019): a grid
with cliffs, gold, a monster and a treasure, one reward component each. Learned with ``DecomposedDQNLoss`` from every
transition, held against value iteration, and explained by RDX and MSX. The grid is one of our own in their manner.

    python examples/cliff_world/cliff.py
"""

from __future__ import annotations

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn
from torchrl.objectives import HardUpdate

from xqmap.explanations import Decision, contrast
from xqmap.objectives import DecomposedDQNLoss

# S the start, C a cliff, G gold, M a monster, T the treasure; each of the last four ends the episode.
GRID = ("S....", ".....", "GCCC.", ".M..T")
COMPONENTS = ("cliff", "gold", "monster", "treasure")
PAYS = {"C": (-10.0, 0, 0, 0), "G": (0, 4.0, 0, 0), "M": (0, 0, -10.0, 0), "T": (0, 0, 0, 10.0)}
ACTIONS = ("step up", "step down", "step left", "step right")
MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1))
GAMMA = 0.9
CELLS = [(row, column) for row, line in enumerate(GRID) for column in range(len(line))]


def transitions() -> TensorDict:
    """Every action in every cell where an episode goes on."""
    rows = []
    for here, (row, column) in enumerate(CELLS):
        if GRID[row][column] in PAYS:
            continue
        for action, (down, right) in enumerate(MOVES):
            there = min(max(row + down, 0), len(GRID) - 1), min(max(column + right, 0), len(GRID[0]) - 1)
            kind = GRID[there[0]][there[1]]
            rows.append((here, action, CELLS.index(there), kind in PAYS, PAYS.get(kind, (0.0,) * 4)))
    here, action, there, over, paid = (torch.tensor(column) for column in zip(*rows, strict=True))
    following = {"cell": there, "done": over, "terminated": over, "reward_components": paid}
    return TensorDict({"cell": here, "action": action, "next": TensorDict(following, [len(rows)])}, [len(rows)])


def exact(batch: TensorDict) -> Tensor:
    """``[N, 4, 4]``: Q*_k of every cell and action, by value iteration."""
    values = torch.zeros(len(CELLS), 4, 4, dtype=torch.float64)
    here, action, there = batch["cell"], batch["action"], batch["next", "cell"]
    goes_on = ~batch["next", "done"][:, None]
    for _ in range(500):
        best = values.sum(1).argmax(-1)
        future = values[there, :, best[there]] * goes_on
        values[here, :, action] = batch["next", "reward_components"].double() + GAMMA * future
    return values


def learned(batch: TensorDict, updates: int) -> Tensor:
    """The same from temporal differences: a table of values is the network."""
    table = nn.Embedding(len(CELLS), 16)
    nn.init.zeros_(table.weight)
    network = TensorDictSequential(
        TensorDictModule(nn.Sequential(table, nn.Unflatten(-1, (4, 4))), ["cell"], ["component_action_value"]),
        TensorDictModule(lambda parts: parts.sum(-2), ["component_action_value"], ["action_value"]),
    )
    loss = DecomposedDQNLoss(network, components=COMPONENTS, loss_function="l2", reduction="sum")
    loss.make_value_estimator(gamma=GAMMA)
    target = HardUpdate(loss, value_network_update_interval=1)
    # With the squared distance a step of one half moves a value all the way.
    optimizer = torch.optim.SGD(loss.parameters(), lr=0.5)
    for _ in range(updates):
        losses = loss(batch)
        sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
        optimizer.step()
        optimizer.zero_grad()
        target.step()
    return loss.value_network_params["module", "0", "module", "0", "weight"].detach().reshape(-1, 4, 4)


def main(updates: int = 100) -> None:
    """Learns, compares, and tells why the near gold is left, and what a cliff and a monster have to do with it."""
    batch = transitions()
    truth, values = exact(batch), learned(batch, updates)
    known = batch["cell"].unique()
    print(f"learned and exact values differ by {float((values - truth)[known].abs().max()):.1e} at most")
    for cell, other in (((1, 0), "step down"), ((1, 1), "step down"), ((3, 2), "step left")):
        decision = Decision.from_values(
            values[CELLS.index(cell)], ACTIONS, COMPONENTS, errors=[1e-6] * 4, task="cliff world"
        )
        print(f"\nIn row {cell[0]}, column {cell[1]}, why not {other}?\n{decision.why(other)}")
        values_of = {thing.object: thing.values for thing in decision.objects}
        delta = contrast.rdx(decision.selected.values, values_of[other])
        print("RDX:", ", ".join(f"{name} {value:+.2f}" for name, value in delta.items()))
        plus, minus = contrast.msx(delta)
        print(f"MSX+: {', '.join(plus) or 'nothing'}; MSX-: {', '.join(minus) or 'nothing'}")


if __name__ == "__main__":
    main()
