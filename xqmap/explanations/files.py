"""A decision as files: ``decision.json``, which says everything in numbers and words, and the maps as ``decision.npz``
beside it.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xqmap.errors import UserError
from xqmap.explanations import contrast
from xqmap.explanations.candidate import Candidate
from xqmap.explanations.reading import MOST_PARTS, parse
from xqmap.explanations.scene import Scene
from xqmap.files import read_bytes, write_atomically

if TYPE_CHECKING:
    from xqmap.explanations.decision import Decision

# Larger files are not ours; bytes, before and after decompression.
_LARGEST_FILE = 10_000_000
_LARGEST_MAPS = 500_000_000
# How far a candidate's value may be from the single-precision map beside it.
_TOLERANCE = 1e-4


def content(decision: Decision, wording: Any = None) -> dict[str, Any]:
    """The content of ``decision.json``: plain values; overall values, RDX, MSX and sentences are derived."""
    msx = []
    for first, second in decision.pairs:
        delta = decision.rdx(first, second)
        pair = (first, second) if sum(delta.values()) >= 0 else (second, first)
        plus, minus = contrast.msx(decision.rdx(*pair))
        msx.append({"pair": list(pair), "plus": plus, "minus": minus})
    result: dict[str, Any] = {
        "task": decision.task,
        "scene_seed": decision.scene_seed,
        "step": decision.step,
        "components": list(decision.components),
        "candidates": [{"label": c.label} | _plain(c) for c in decision.candidates],
        "objects": [_plain(thing) for thing in decision.objects],
        "rdx": [{"pair": [a, b], "values": decision.rdx(a, b)} for a, b in decision.pairs],
        "msx": msx,
        "noise": decision.noise,
        "played": [{"label": label, "returns": returns} for label, returns in decision.played.items()],
        "sentences": decision.sentences(wording),
    }
    if decision.scene is not None:
        scene = decision.scene
        result["scene"] = {
            "names": scene.names,
            "background": scene.background,
            "bounds": np.asarray(scene.bounds).tolist(),
        }
    return result


def save(decision: Decision, path: Path, wording: Any = None) -> list[Path]:
    """Writes the decision file, and the maps beside it where the decision has them."""
    write_atomically(path, (json.dumps(content(decision, wording), indent=1, allow_nan=False) + "\n").encode())
    if decision.maps is None or decision.scene is None or decision.heightmap is None:
        return [path]
    beside, buffer = path.with_suffix(".npz"), io.BytesIO()
    parts: dict[str, Any] = {}
    if decision.parts is not None and decision.parts.shape[1] > 1:
        parts["parts"] = decision.parts.astype(np.float32)
    np.savez_compressed(
        buffer,
        **parts,
        maps=decision.maps.astype(np.float32),
        color=decision.heightmap[:3].astype(np.uint8),
        height=decision.heightmap[3].astype(np.float32),
        cells=decision.scene.cells.astype(np.int16),
    )
    write_atomically(beside, buffer.getvalue())
    return [path, beside]


def load(path: Path) -> dict[str, Any]:
    """The fields of the decision that a file holds: what :func:`save` wrote, or any decision file.

    Raises:
        UserError: naming the file and the place that is wrong.
    """
    try:
        read = json.loads(read_bytes(path, _LARGEST_FILE))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not JSON ({str(error)[:80]})") from None
    fields, beside = parse(read, str(path)), path.with_suffix(".npz")
    if "scene" in read and beside.exists():
        fields |= _maps(fields, read["scene"], beside)
    return fields


def _maps(fields: dict[str, Any], scene: Any, beside: Path) -> dict[str, Any]:
    """The maps, the heightmap and the scene, if they are those of this decision."""
    try:
        packed_bytes = io.BytesIO(read_bytes(beside, _LARGEST_FILE * 10))
        with zipfile.ZipFile(packed_bytes) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > _LARGEST_MAPS:
                raise UserError(f"{beside}: larger than {_LARGEST_MAPS // 1_000_000} MB, which no maps are")
        with np.load(packed_bytes, allow_pickle=False) as arrays:
            maps, color, height, cells = (arrays[name] for name in ("maps", "color", "height", "cells"))
            parts = arrays.get("parts", maps[:, None])
        names = [str(name)[:200] for name in scene["names"]]
        bounds = np.array(scene["bounds"], dtype=float)
        rows, columns = cells.shape
        fits = (
            maps.shape == (len(fields["components"]), rows, columns)
            and color.shape == (3, rows, columns)
            and height.shape == cells.shape
        )
        fits = fits and parts.ndim == 4 and (*parts.shape[:1], *parts.shape[2:]) == maps.shape
        fits = fits and 1 <= parts.shape[1] <= MOST_PARTS and not np.isinf(parts).any()
        fits = fits and bounds.shape == (3, 2) and bool(np.isfinite(bounds).all() and np.isfinite(height).all())
        fits = fits and int(cells.min()) >= -1 and int(cells.max()) < len(names) and not np.isinf(maps).any()
        for candidate in fields["candidates"]:
            stored = maps[:, candidate.pixel[0], candidate.pixel[1]] if fits and candidate.pixel else np.array([np.inf])
            fits = fits and bool(np.allclose(stored, list(candidate.values.values()), atol=_TOLERANCE, rtol=_TOLERANCE))
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        raise UserError(
            f"{beside}: not the maps of a decision ({type(error).__name__}); without it the numbers alone are explained"
        ) from None
    if not fits:
        raise UserError(
            f"{beside}: does not belong to the decision beside it; without it the numbers alone are explained"
        )
    heightmap = np.concatenate((color.astype(np.float32), height[None].astype(np.float32)))
    lying = Scene(names, cells.astype(int), str(scene["background"])[:200], bounds.tolist(), heightmap[3])
    # Known everywhere where they are known of the candidates.
    known = parts.astype(float) if fields["candidates"][0].parts is not None else None
    return {"maps": maps.astype(float), "heightmap": heightmap, "scene": lying, "parts": known}


def _plain(candidate: Candidate) -> dict[str, Any]:
    result: dict[str, Any] = {"object": candidate.object}
    result |= {"pixel": list(candidate.pixel)} if candidate.pixel is not None else {}
    result |= {"position": list(candidate.position)} if candidate.position is not None else {}
    result |= {"values": candidate.values, "overall": candidate.overall, "object_index": candidate.object_index}
    if candidate.parts is None:
        return result
    result |= {"now": candidate.now, "later": candidate.later}
    ahead = {name: parts[1:] for name, parts in candidate.parts.items()}
    return result | {"when": ahead} if max(map(len, ahead.values())) > 1 else result
