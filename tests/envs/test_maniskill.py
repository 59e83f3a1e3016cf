"""What a world shows, and when that is not enough to go on with."""

from __future__ import annotations

import pytest
import torch

from tests.toy import ToyTask
from xqmap import keys
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import WorldError


@pytest.mark.parametrize(("blind_after", "goes_on"), [(1, False), (2, True)])
def test_nothing_to_see_matters_only_where_a_choice_is_to_be_made(blind_after: int, goes_on: bool) -> None:
    class Blind(ToyTask):
        def _observation(self):  # type: ignore[no-untyped-def]
            seen = super()._observation()
            if self.made >= blind_after:
                seen["sensor_data"]["above"]["depth"].zero_()
            return seen

    env = ManiSkillEnv(Blind)
    state = env.reset()
    state[keys.ACTION] = torch.tensor(0)
    if not goes_on:
        with pytest.raises(WorldError, match="heightmap is empty"):
            env.step(state)
        return
    following = env.step(state)["next"]
    following[keys.ACTION] = torch.tensor(0)
    last = env.step(following.exclude(keys.REWARD))["next"]
    assert bool(last[keys.DONE])
    assert not bool(last[keys.ACTION_MASK].any())
