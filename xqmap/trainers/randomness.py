"""Every random number generator a run draws from, as named tensors, so that a run that goes on draws what it would have
drawn.
"""

from __future__ import annotations

import random
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor


def states(generators: Mapping[str, torch.Generator]) -> dict[str, Tensor]:
    """The states of ``generators`` and of the global ones of torch (each GPU's, too), numpy and Python."""
    found = {name: generator.get_state() for name, generator in generators.items()}
    found |= {"torch": torch.get_rng_state()}
    if torch.cuda.is_available():
        found |= {f"cuda{i}": state for i, state in enumerate(torch.cuda.get_rng_state_all())}
    _, words, position, has_gauss, gauss = np.random.get_state(legacy=True)
    found["numpy"] = torch.from_numpy(np.asarray(words, dtype=np.int64))
    found["numpy_rest"] = torch.tensor([position, has_gauss, gauss], dtype=torch.float64)
    _, python, python_gauss = random.getstate()
    found["python"] = torch.tensor(python)
    found["python_gauss"] = torch.tensor([] if python_gauss is None else [python_gauss], dtype=torch.float64)
    return found


def restore(saved: Mapping[str, Tensor], generators: Mapping[str, torch.Generator]) -> None:
    """The inverse of :func:`states`; a GPU that was not there before keeps its own state."""
    for name, generator in generators.items():
        generator.set_state(saved[name])
    torch.set_rng_state(saved["torch"])
    if torch.cuda.is_available():
        for i in range(torch.cuda.device_count()):
            if f"cuda{i}" in saved:
                torch.cuda.set_rng_state(saved[f"cuda{i}"], i)
    position, has_gauss, gauss = saved["numpy_rest"].tolist()
    np.random.set_state(("MT19937", saved["numpy"].numpy().astype(np.uint32), int(position), int(has_gauss), gauss))
    python_gauss = saved["python_gauss"].tolist()
    random.setstate((3, tuple(saved["python"].tolist()), python_gauss[0] if python_gauss else None))
