"""What is still wrong is drawn more often, in just that proportion, and learned to the same values."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import HardUpdate

from tests.objectives.test_decomposed_dqn import Table, make_loss, toy_transitions
from tests.toy import exact_values
from xqmap.config import build, schema
from xqmap.data.samplers import PrioritySampler
from xqmap.errors import UserError


def buffer(
    capacity: int, batch_size: int, alpha: float = 0.6, beta: tuple[float, float] = (0.4, 1.0)
) -> TensorDictReplayBuffer:
    generator = torch.Generator().manual_seed(0)
    storage, sampler = LazyTensorStorage(capacity), PrioritySampler(capacity, alpha, *beta)
    return TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=batch_size, generator=generator)


def numbered(*numbers: int) -> TensorDict:
    return TensorDict({"number": torch.tensor(numbers)}, [len(numbers)])


@pytest.mark.parametrize("alpha", [0.0, 0.6, 1.0])
def test_transitions_come_as_often_as_their_priorities_say(alpha: float) -> None:
    draws = 50_000
    replay = buffer(8, draws, alpha)
    replay.extend(numbered(*range(5)))
    errors = torch.tensor([0.0, 0.1, 0.5, 1.0, 4.0])
    replay.update_priority(torch.arange(5), errors)
    expected = (errors.double() + 1e-6) ** alpha
    expected /= expected.sum()
    seen = replay.sample()["number"].bincount(minlength=5) / draws
    # Five standard deviations of a share.
    assert bool(((seen - expected).abs() <= 5 * (expected * (1 - expected) / draws).sqrt() + 1e-9).all())


def test_weights_take_back_the_bias_as_training_goes_on() -> None:
    draws = 100_000
    replay = buffer(4, draws, alpha=0.7, beta=(0.0, 1.0))
    replay.extend(numbered(0, 1, 2, 3))
    replay.update_priority(torch.arange(4), torch.tensor([0.1, 0.4, 1.0, 3.0]))
    assert bool((replay.sample()["priority_weight"] == 1).all())
    replay.sampler.progress = 1.0
    batch = replay.sample()
    weight = batch["priority_weight"]
    assert float(weight.max()) == 1.0
    # Fully weighed, the mean over samples is the mean over what is stored.
    assert float((weight * batch["number"]).sum() / weight.sum()) == pytest.approx(1.5, abs=0.03)


def test_new_transitions_come_first_and_the_largest_error_of_several_counts() -> None:
    replay = buffer(3, 2, alpha=1.0)
    replay.extend(numbered(0, 1))
    replay.update_priority(torch.tensor([0, 1, 0]), torch.tensor([5.0, 0.1, 2.0]))
    priorities = replay.sampler.priorities
    assert priorities.tolist() == pytest.approx([5.0, 0.1, 0.0], abs=1e-5)
    replay.extend(numbered(2, 3))
    assert priorities.tolist() == pytest.approx([5.0, 0.1, 5.0], abs=1e-5)
    replay.add(numbered(4)[0])
    assert priorities.tolist() == pytest.approx([5.0, 5.0, 5.0], abs=1e-5)


def test_priorities_are_written_and_read_back(tmp_path: Path) -> None:
    first, second = PrioritySampler(3, 1.0, 0.4, 1.0), PrioritySampler(3, 1.0, 0.4, 1.0)
    first.extend(torch.tensor([0, 2]))
    first.update_priority(torch.tensor([2]), torch.tensor([7.0]))
    first.dumps(tmp_path / "sampler")
    second.loads(tmp_path / "sampler")
    assert torch.equal(first.priorities, second.priorities)


def test_toy_world_is_learned_to_its_exact_values_from_prioritized_samples() -> None:
    torch.manual_seed(0)
    made, network = toy_transitions(), Table(2)
    loss = make_loss(network, ["left", "right"], gamma=0.5, loss_function="l2")
    updater, optimizer = (
        HardUpdate(loss, value_network_update_interval=20),
        torch.optim.Adam(loss.parameters(), lr=0.05),
    )
    replay = buffer(len(made), 6)
    replay.extend(made)
    for _ in range(1200):
        batch = replay.sample()
        losses = loss(batch)
        optimizer.zero_grad()
        (losses["loss_left"] + losses["loss_right"]).backward()
        optimizer.step()
        updater.step()
        replay.update_priority(batch["index"], batch["td_error"])
    for patch, exact in exact_values((0, 1, 2), 0, 0.5).items():
        assert torch.allclose(network.values[0, :, patch], torch.tensor(exact, dtype=torch.float32), atol=1e-2)


def test_settings_choose_the_sampler_and_bad_ones_are_named(toy_config: Callable[..., DictConfig]) -> None:
    assert not isinstance(build.replay(toy_config()).sampler, PrioritySampler)
    sampler = build.replay(toy_config("replay=prioritized", "replay.beta_init=0.7", "replay.capacity=50")).sampler
    assert isinstance(sampler, PrioritySampler)
    assert (sampler.alpha, sampler.beta_init, sampler.beta_end, len(sampler.priorities)) == (0.6, 0.7, 1.0, 50)
    for setting, named in {
        "replay.alpha=-1": r"replay\.alpha=-1",
        "replay.beta_init=2": r"replay\.beta_init=2",
        "replay.beta_end=nan": r"replay\.beta_end=nan",
        "replay.capacity=20000000": r"replay\.capacity=20000000.*16777216",
    }.items():
        with pytest.raises(UserError, match=named):
            schema.validate(toy_config("replay=prioritized", setting))
