"""Worlds as torchrl environments: the contract, what holds a world to it, and heightmaps."""

from typing import Any

__all__ = ["check_task"]


def __getattr__(name: str) -> Any:
    if name == "check_task":
        # Late: torchrl takes seconds, and whoever reads a decision's heightmap needs none of it.
        from xqmap.envs.check import check_task

        return check_task
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
