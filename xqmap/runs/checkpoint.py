"""The format of a checkpoint: named tensors with JSON facts, as safetensors; reading one runs no code."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from xqmap.config import arguments
from xqmap.errors import UserError
from xqmap.files import forget_unfinished, opened, replacing
from xqmap.runs.places import BEST as BEST
from xqmap.runs.places import POLICY as POLICY
from xqmap.runs.places import TRAINING as TRAINING

_FORMAT = 2
# Bytes of a policy and of a training, which has the replay buffer with it; signs of the facts beside the tensors.
_LARGEST_POLICY = 4 * 2**30
_LARGEST_TRAINING = 2**40
_LONGEST_FACTS = 20_000_000
# What a checkpoint of a training tells besides what a policy's does.
_TO_GO_ON = (
    "frames",
    "updates",
    "scene",
    "unfinished",
    "explored",
    "cursor",
    "target_age",
    "next_picture",
    "best",
    "noise",
    "wandb_id",
)
_LIBRARIES = ("torch", "torchrl", "tensordict", "mani-skill", "sapien", "hydra-core", "wandb", "numpy")


def versions() -> dict[str, str]:
    """The libraries that results depend on, by name."""
    return {name: version(name) for name in _LIBRARIES}


def weights_sha256(state: dict[str, Tensor]) -> str:
    """SHA-256 of named tensors: their names, shapes and bytes, in name order."""
    digest = hashlib.sha256()
    for name in sorted(state):
        tensor = state[name].detach().cpu().contiguous()
        digest.update(f"{name}{tuple(tensor.shape)}{tensor.dtype}".encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


def write(path: Path, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
    """Writes named tensors with JSON facts, the versions they were made with and checksums of both."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    text = json.dumps(facts | {"versions": versions(), "sha256": weights_sha256(tensors)})
    with replacing(path) as beside:
        try:
            save_file(tensors, beside, {"xqmap": text, "sha256": _sha256(text), "format": str(_FORMAT)})
        except SafetensorError as error:
            # The library wraps what the system said.
            code = errno.ENOSPC if "No space left" in str(error) or "os error 28" in str(error) else errno.EIO
            raise OSError(code, os.strerror(code), str(path)) from None


def read(path: Path, limit: int = _LARGEST_POLICY) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What :func:`write` wrote, after checking it.

    Args:
        path: of the file.
        limit: bytes it may have.

    Raises:
        UserError: if the file is missing, damaged, foreign or of another format.
    """
    if not path.exists():
        raise UserError(f"there is no {path}: give the directory of a run that got as far as its first checkpoint")
    opened(path, limit).close()
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if len(metadata.get("xqmap", "")) > _LONGEST_FACTS:
                raise UserError(f"{path} was not written by xqmap: no training has so much to tell")
            stored = metadata.get("format", "")
            if "xqmap" not in metadata or not stored.isdecimal():
                raise UserError(f"{path} was not written by xqmap: give the directory of one of its runs")
            if stored != str(_FORMAT):
                fix = "update xqmap" if int(stored) > _FORMAT else "train again"
                raise UserError(f"{path} has format {stored}, this version of xqmap reads {_FORMAT}: {fix}")
            if _sha256(metadata["xqmap"]) != metadata.get("sha256"):
                raise UserError(
                    f"{path} is damaged (the checksum of its settings does not match): train again or use another run"
                )
            facts = json.loads(metadata["xqmap"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except (SafetensorError, ValueError, RecursionError, OSError) as error:
        raise UserError(f"{path} is damaged ({str(error)[:200]}): train again or use another run") from None
    if not isinstance(facts, dict) or weights_sha256(tensors) != facts.get("sha256"):
        raise UserError(f"{path} is damaged (its checksum does not match): train again or use another run")
    return tensors, facts


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def trainings(directory: Path) -> list[Path]:
    """The checkpoints a run can go on from, newest first."""
    found = {
        path: re.fullmatch(r"training-(\d+)\.safetensors", path.name)
        for path in (directory / TRAINING).parent.glob("training-*")
    }
    return sorted(
        (path for path, match in found.items() if match), key=lambda path: int(path.stem.split("-")[1]), reverse=True
    )


def read_training(place: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What a training goes on from: the newest checkpoint of a run directory, or the one given as a file.

    Raises:
        UserError: if there is none or it cannot be used; the message names the one before it, where there is one.
    """
    kept = [place] if place.suffix == ".safetensors" else trainings(place)
    if not kept:
        raise UserError(
            f"there is no checkpoint in {place} to go on from: give the directory of a run that got as far as its "
            "first one"
        )
    try:
        found = read(kept[0], _LARGEST_TRAINING)
        if missing := [name for name in _TO_GO_ON if name not in found[1]]:
            raise UserError(
                f"{kept[0]} holds no training to go on from (no {missing[0]}): give resume=DIR, a run directory"
            )
        return found
    except UserError as error:
        if len(kept) == 1:
            raise
        before = arguments.setting("resume", kept[1])
        raise UserError(f"{error}, or go on from the checkpoint before it: {before}") from None


def prune(directory: Path, frames: int, keep: int) -> None:
    """Removes all but the last ``keep`` checkpoints up to the one of ``frames``; later ones are of a future that was
    given up.
    """
    forget_unfinished((directory / TRAINING).parent)
    for path in trainings(directory):
        if int(path.stem.split("-")[1]) > frames:
            path.unlink()
    for path in trainings(directory)[keep:]:
        path.unlink()
