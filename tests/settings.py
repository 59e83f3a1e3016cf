"""Settings as the commands read them, for tests that build a world by itself."""

from __future__ import annotations

from typing import Any

from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from xqmap.config import plugins, schema


def world_settings(task: str, **changes: Any) -> dict[str, Any]:
    """The defaults of ``conf/task/<task>.yaml``'s world, with some changed: the arguments of its class."""
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        env = OmegaConf.to_container(compose("config", [f"+task={task}"]).task.env)
    assert isinstance(env, dict)
    return {str(key): value for key, value in env.items() if key != "_target_"} | changes
