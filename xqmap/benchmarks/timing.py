"""How seconds are taken, and held against goals."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from tqdm import tqdm


def alternating(*functions: Callable[[], Any], rounds: int) -> list[float]:
    """Median seconds of each function, called in turn after one call each to warm up."""
    seconds: list[list[float]] = [[] for _ in functions]
    for function in functions:
        function()
    for _ in tqdm(range(rounds), unit="round", desc="measuring"):
        for function, taken in zip(functions, seconds, strict=True):
            start = time.perf_counter()
            function()
            taken.append(time.perf_counter() - start)
    return [statistics.median(taken) for taken in seconds]


class Convolutions(TorchDispatchMode):
    """Notes every convolution and its backward: one call with its arguments for each shape, and how often it came."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: dict[str, tuple[Callable[[], Any], int]] = {}

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in (torch.ops.aten.convolution.default, torch.ops.aten.convolution_backward.default):
            shape = str([(tuple(a.shape), a.dtype, a.stride()) if isinstance(a, torch.Tensor) else a for a in args])
            call, count = self.calls.get(shape, (partial(func, *args, **(kwargs or {})), 0))
            self.calls[shape] = call, count + 1
        return func(*args, **(kwargs or {}))

    def seconds(self, rounds: int) -> float:
        """What the same convolutions take when nothing else is done: the most that this machine allows."""
        with torch.no_grad():
            return sum(count * taking(call, rounds) for call, count in self.calls.values())


def taking(call: Callable[[], Any], rounds: int) -> float:
    """Median seconds, after one call to warm up."""
    call()
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def goals(measured: dict[str, float], least: dict[str, float], most: dict[str, float] | None = None) -> dict[str, str]:
    """Each number against the least, or the most, that it should be."""
    lines = {}
    for name, goal in {**least, **(most or {})}.items():
        missed = measured[name] < goal if name in least else measured[name] > goal
        word, by = ("at least", 1 - measured[name] / goal) if name in least else ("at most", measured[name] / goal - 1)
        lines[name] = f"{measured[name]:.3g}, {word} {goal:g}: " + (f"missed by {by:.0%}" if missed else "reached")
    return lines


def machine() -> dict[str, Any]:
    """What the numbers were measured on."""
    return {"processors": os.cpu_count(), "torch_threads": torch.get_num_threads(), "torch": torch.__version__}
