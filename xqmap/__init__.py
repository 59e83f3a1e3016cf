"""Explainable Q-Map learning: one Q-Map per reward component, one argmax of their sum, and explanations from the same
numbers.
"""

import os
from pathlib import Path
from typing import Any

from xqmap import launch, matplotlib_import  # noqa: F401 (before anything else takes time, or imports matplotlib)

# Idle OpenMP threads that spin take the processor from the simulator and from other programs; beside one busy neighbour
# on two processors an update was ten times slower with spinning. Has to be set before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# Of a user without a home (a container's), SAPIEN says no word and finds no shaders later on.
try:
    Path.home()
except RuntimeError:
    os.environ["HOME"] = "/nonexistent"

__all__ = ["load", "make_env", "settings", "train"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        # Late: torchrl takes seconds, and a command that only reads a decision needs none of it.
        from xqmap import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
