"""A policy as a program of its own: heightmap and mask in; Q-Maps, their sum, the action and intervals out."""

from __future__ import annotations

import json
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.export import Dim

from xqmap.errors import UserError
from xqmap.files import replacing, write_atomically
from xqmap.models.policy import masked_argmax
from xqmap.models.qmaps import QMaps
from xqmap.runs.run import Run

OUTPUTS = ("maps", "total", "action", "intervals")
# How far a program's values may be from the policy's.
_TOLERANCE = 1e-4
# Heightmaps that both are asked.
_ASKED = 3


class Program(nn.Module):
    """What is taken away of a policy.

    Args:
        qmaps: its network.
        noise: typical error of each component's values, in order; 0 where unknown.
    """

    def __init__(self, qmaps: QMaps, noise: list[float]) -> None:
        super().__init__()
        self.qmaps = qmaps
        self.register_buffer("noise", torch.tensor(noise) * qmaps.weights.cpu())

    def forward(self, heightmap: Tensor, mask: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """``heightmap`` ``[B, 4, H, W]`` (0–255 and metres above the floor) and ``mask`` ``[B, H · W]`` bool, the cells
        that can be chosen (all, if it allows none).

        Returns:
            ``maps`` ``[B, K, H, W]``, weighted; ``total`` ``[B, H, W]``; ``action`` ``[B]``, row · W + column;
            ``intervals`` ``[B, K, 2]``, the chosen cell's values, less and more their typical error.
        """
        maps = self.qmaps.maps(heightmap) * self.qmaps.weights[:, None, None]
        total = maps.sum(1)
        action = masked_argmax(total.flatten(1), mask)
        chosen = maps.flatten(2).gather(-1, action[:, None, None].expand(-1, maps.shape[1], 1)).squeeze(-1)
        return maps, total, action, torch.stack((chosen - self.noise, chosen + self.noise), -1)


def files(out: Path, onnx: bool) -> list[Path]:
    """What :func:`write` writes."""
    return [out, out.with_suffix(".json"), *([out.with_suffix(".onnx")] if onnx else [])]


def write(run: Run, out: Path, onnx: bool = False) -> dict[str, Any]:
    """Writes a run's policy as a program, and what its numbers mean as JSON beside it.

    Args:
        run: whose policy.
        out: the ``.pt2`` file.
        onnx: write an ONNX file of the same name, too.

    Returns:
        The facts of the JSON; ``difference`` says by how much a value was off at most, by file.

    Raises:
        UserError: if a program differs from the policy, or ONNX is asked for and not installed.
    """
    if onnx:
        _require_onnx()
    env = run.make_env()
    env.close()
    rows, columns = env.grid.shape
    components = list(map(str, run.cfg.method.components))
    program = Program(run.policy.qmaps.cpu(), [run.noise.get(name, 0.0) for name in components]).eval()
    generator = torch.Generator().manual_seed(0)
    scale = torch.tensor([255, 255, 255, 0.1])[:, None, None]
    heightmap = torch.rand(_ASKED, 4, rows, columns, generator=generator) * scale
    mask = torch.rand(_ASKED, rows * columns, generator=generator) < 0.5
    with torch.no_grad():
        expected = program(heightmap, mask)
    # With gradients: without them a processor goes through a batch map by map, and the program would keep its length.
    batch = {0: Dim("batch", min=1, max=1024)}
    made = torch.export.export(program, (heightmap, mask), dynamic_shapes=(batch, batch))
    difference = {}
    with replacing(out) as beside:
        with warnings.catch_warnings():
            # Of the noise it says that it may not be on a processor; it is.
            warnings.filterwarnings("ignore", "No complete tensor found")
            torch.export.save(made, beside)
        difference[out.name] = _held(torch.export.load(beside).module(), heightmap, mask, expected, out.name)
    if onnx:
        target = out.with_suffix(".onnx")
        with replacing(target) as beside:
            difference[target.name] = _as_onnx(made, beside, heightmap, mask, expected)
    facts = {
        "task": str(run.cfg.task.name),
        "method": str(run.cfg.method.name),
        "components": components,
        "weights": run.policy.qmaps.weights.tolist(),
        "typical_error": {name: run.noise.get(name) for name in components},
        "inputs": {
            "heightmap": {
                "shape": ["B", 4, rows, columns],
                "channels": ["R 0-255", "G 0-255", "B 0-255", "height in m above the floor"],
                "normalisation": "none: it is part of the program; a cell that no camera saw is 0 in all four",
            },
            "mask": {"shape": ["B", rows * columns], "meaning": "true where an action can be chosen, row * W + column"},
        },
        "outputs": list(OUTPUTS),
        "pixel_size_m": env.grid.pixel_size,
        "bounds_of_scene_0_m": [list(map(float, pair)) for pair in env.grid.bounds],
        "floor_m": float(env.grid.bounds[2][0]),
        "rows_and_columns": "rows are the second world axis, columns the first; a cell's middle is half a pixel in",
        "weights_sha256": run.sha256,
        "versions": {name: version(name) for name in ("torch", "xqmap")},
        "difference": difference,
    }
    write_atomically(out.with_suffix(".json"), (json.dumps(facts, indent=1) + "\n").encode())
    return facts


def _held(program: Any, heightmap: Tensor, mask: Tensor, expected: tuple[Tensor, ...], name: str) -> float:
    """The largest difference of values, over all of a batch and over its first."""
    worst = 0.0
    for count in (len(heightmap), 1):
        with torch.no_grad():
            found = program(heightmap[:count], mask[:count])
        worst = max(worst, *(float((a - b[:count]).abs().max()) for a, b in zip(found, expected, strict=True)))
    if not worst <= _TOLERANCE:
        raise UserError(f"{name} differs from the policy by {worst:.1e}, more than {_TOLERANCE:g}: nothing was written")
    return worst


def _require_onnx() -> None:
    try:
        # An extra that few need.
        import onnxruntime  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError:
        raise UserError("onnx=true needs the extra 'onnx': pip install 'xqmap[onnx]'") from None


def _as_onnx(made: Any, place: Path, heightmap: Tensor, mask: Tensor, expected: tuple[Tensor, ...]) -> float:
    # An extra that few need.
    import onnxruntime

    names: dict[str, Any] = {"input_names": ["heightmap", "mask"], "output_names": list(OUTPUTS)}
    torch.onnx.export(made, (), place, dynamo=True, external_data=False, verbose=False, **names)
    session = onnxruntime.InferenceSession(str(place), providers=["CPUExecutionProvider"])

    def ask(image: Tensor, allowed: Tensor) -> list[Tensor]:
        given = {"heightmap": image.numpy(), "mask": allowed.numpy()}
        return [torch.from_numpy(found) for found in session.run(None, given)]

    return _held(ask, heightmap, mask, expected, place.name)
