"""Training's scenes can differ from those that are played."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, open_dict

from xqmap.config import build, plugins, schema
from xqmap.errors import UserError


def composed(*overrides: str) -> DictConfig:
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        return compose("config", list(overrides))


@pytest.mark.parametrize(
    ("told", "played", "practised"),
    [((), [7, 10], [3, 10]), (("task.env.objects=[12,15]",), [12, 15], [3, 15]), (("task.env.objects=2",), 2, [2, 2])],
)
def test_few_objects_are_practised_up_to_as_many_as_are_played(
    told: tuple[str, ...], played: object, practised: object
) -> None:
    for task in ("grasping", "foresight"):
        cfg = composed(f"+task={task}", *told)
        assert cfg.task.env.objects == played
        practice = build.practice(cfg)
        assert practice.task.env.objects == practised
        # Nothing else differs, and the settings that evaluation plays stay as they were.
        assert cfg.task.env.objects == played
        assert {k: v for k, v in practice.task.env.items() if k != "objects"} == {
            k: v for k, v in cfg.task.env.items() if k != "objects"
        }


def test_a_setting_that_the_world_has_not_is_refused(toy_config: Callable[..., DictConfig]) -> None:
    cfg = toy_config()
    with open_dict(cfg):
        cfg.task.practice = {"objects": 3}
    with pytest.raises(UserError, match=r"task\.practice names \['objects'\], which task\.env does not set"):
        schema.validate(cfg)
