"""What a run leaves to be loaded: weights to hand out, and everything needed to go on. Safetensors only: loading runs
no code.

A file is written beside its place and moved there when complete, so a reader finds the old one or the new one, never
half of one.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from xqmap.config import arguments, schema
from xqmap.errors import UserError
from xqmap.models.policy import GreedyPolicy

# The newest policy, the one that chose best among the last training decisions, and what it takes to go on from a
# decision.
POLICY = Path("checkpoint/policy.safetensors")
BEST = Path("checkpoint/best.safetensors")
TRAINING = "checkpoint/training-{:06d}.safetensors"
# Run directories that ship with the package: ``run=pretrained/<task>``.
PRETRAINED = Path(__file__).parents[1] / "pretrained"
_FORMAT = 2
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


def locate(run: str | Path) -> Path:
    """The directory of a run; ``pretrained/<task>`` is one that ships with the package, unless there is such a
    directory here.

    Raises:
        UserError: if no agent of that name ships.
    """
    path = Path(run)
    if path.exists() or len(path.parts) != 2 or path.parts[0] != PRETRAINED.name:
        return path
    shipped = sorted(entry.parent.parent.name for entry in PRETRAINED.glob(f"*/{POLICY}"))
    if path.name not in shipped:
        raise UserError(
            f"run={path}: no such agent ships with xqmap; {', '.join(shipped) or 'none'} do, make pretrained trains "
            "them"
        )
    return PRETRAINED / path.name


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


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A name beside ``path`` to write to; it is moved to ``path`` when complete, and gone if that fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    try:
        yield beside
        with open(beside, "rb") as file:
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        raise


def require_place(path: Path) -> Path:
    """``path``, if a file can be put there: to be asked before the work whose result it is to hold.

    Raises:
        OSError: if it cannot.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    nearest = next(folder for folder in path.absolute().parents if folder.exists())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            return path
    except OSError as error:
        raise OSError(error.errno, os.strerror(error.errno or errno.EIO), str(path)) from None


def write_atomically(path: Path, content: bytes) -> None:
    """Puts ``content`` at ``path`` completely or not at all."""
    with replacing(path) as beside:
        beside.write_bytes(content)


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


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What :func:`write` wrote, after checking it.

    Raises:
        UserError: if the file is missing, damaged, foreign or of another format.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
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
    except FileNotFoundError:
        raise UserError(
            f"there is no {path}: give the directory of a run that got as far as its first checkpoint"
        ) from None
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
        found = read(kept[0])
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
    for path in trainings(directory):
        if int(path.stem.split("-")[1]) > frames:
            path.unlink()
    for path in trainings(directory)[keep:]:
        path.unlink()


def home(place: str | Path) -> Path:
    """Where what is made from a run belongs: its directory, the folder of the same name beside a single policy file,
    or, of an agent that ships with the package, the current directory.
    """
    place = locate(place)
    if place.resolve().is_relative_to(PRETRAINED):
        return Path()
    return place.with_suffix("") if place.suffix == ".safetensors" else place


@dataclass
class Run:
    """A training: its settings, its policy, its values' typical error by component, where it lies, and the decisions
    learned from.
    """

    directory: Path
    cfg: DictConfig
    policy: GreedyPolicy
    noise: dict[str, float]
    sha256: str
    decisions: int


def load_run(place: str | Path) -> Run:
    """The policy of a run directory, or of one policy file. Its settings come from the file's own metadata; nothing in
    it is executed.

    Raises:
        UserError: if there is no readable policy.
    """
    from xqmap.config import build  # build imports ManiSkill, which reading settings does not need

    place = locate(place)
    file = place if place.suffix == ".safetensors" else place / POLICY
    tensors, facts = read(file)
    cfg = settings(facts, file)
    misfit = f"{file} does not fit its own settings"
    try:
        decisions = int(facts["frames"])
        pixel_size, noise = (
            float(facts["pixel_size"]),
            {str(name): float(value) for name, value in facts["noise"].items()},
        )
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise UserError(f"{misfit} ({error}): train again") from None
    if not (math.isfinite(pixel_size) and pixel_size > 0 and all(map(math.isfinite, noise.values()))):
        raise UserError(f"{misfit} (pixel size or noise is not a number above 0): train again")
    try:
        # Without memory first: settings of a stranger could ask for more than there is.
        if build.shapes(cfg, pixel_size) != {name: tensor.shape for name, tensor in tensors.items()}:
            raise UserError(f"{misfit} (its tensors are not those of its network): train again")
        network = build.qmaps(cfg, pixel_size)
        network.load_state_dict(tensors)
    except (RuntimeError, ValueError, TypeError, OverflowError) as error:
        raise UserError(f"{misfit} ({str(error).splitlines()[0][:200]}): train again") from None
    return Run(home(place), cfg, GreedyPolicy(network).eval(), noise, facts["sha256"], decisions)


def settings(facts: dict[str, Any], file: Path) -> DictConfig:
    """The training's configuration, as stored beside the tensors of ``file``: typed, in range, plain values only.

    Raises:
        UserError: if it is anything else.
    """
    stored = facts.get("config")
    if not isinstance(stored, dict) or not _plain(stored):
        raise UserError(f"{file} carries no readable settings: train again")
    try:
        cfg = schema.typed(OmegaConf.create(stored))
        schema.validate(cfg, playing=True)
    except UserError as error:
        raise UserError(f"{file}: {error}") from None
    return cfg


def _plain(value: Any) -> bool:
    """Whether settings hold no ``${...}``, which could read this machine's environment."""
    if isinstance(value, dict):
        return all(_plain(name) and _plain(entry) for name, entry in value.items())
    if isinstance(value, list):
        return all(map(_plain, value))
    return not (isinstance(value, str) and "${" in value)
