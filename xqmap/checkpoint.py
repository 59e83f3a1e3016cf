"""What a run leaves to be loaded: weights to hand out, and everything needed to go on. Safetensors only: loading runs no code.

A file is written beside its place and moved there when complete, so a reader finds the old one or the new one, never half of one.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from xqmap.errors import UserError
from xqmap.models.policy import GreedyPolicy

POLICY = Path("checkpoint/policy.safetensors")
TRAINING = Path("checkpoint/training.safetensors")
_FORMAT = 1
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


def write_atomically(path: Path, content: bytes) -> None:
    """Puts ``content`` at ``path`` completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(path.name + ".part")
    with open(beside, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(beside, path)


def write(path: Path, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
    """Writes named tensors with JSON facts, the versions they were made with and a checksum."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    facts = facts | {"format": _FORMAT, "versions": versions(), "sha256": weights_sha256(tensors)}
    write_atomically(path, save(tensors, {"xqmap": json.dumps(facts)}))


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """What :func:`write` wrote, after checking it.

    Raises:
        UserError: if the file is missing, damaged, foreign or of a newer format.
    """
    try:
        with safe_open(path, framework="pt") as file:
            facts = json.loads((file.metadata() or {}).get("xqmap", "null"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dictionary)
    except FileNotFoundError:
        raise UserError(f"there is no {path}: give the directory of a run that got as far as its first checkpoint") from None
    except (SafetensorError, json.JSONDecodeError, struct.error, OSError) as error:
        raise UserError(f"{path} is damaged ({error}): train again or use another run") from None
    if not isinstance(facts, dict) or "sha256" not in facts:
        raise UserError(f"{path} was not written by xqmap: give the directory of one of its runs")
    if facts.get("format") != _FORMAT:
        raise UserError(f"{path} has format {facts.get('format')}, this version of xqmap reads {_FORMAT}: update xqmap")
    if weights_sha256(tensors) != facts["sha256"]:
        raise UserError(f"{path} is damaged (its checksum does not match): train again or use another run")
    return tensors, facts


@dataclass
class Run:
    """A finished training: its settings, its policy, its values' typical error by component, and where it lies."""

    directory: Path
    cfg: DictConfig
    policy: GreedyPolicy
    noise: dict[str, float]
    sha256: str


def load_run(directory: str | Path) -> Run:
    """The saved policy of a run directory. Its settings come from the file's own metadata, plain YAML; nothing in it is executed.

    Raises:
        UserError: if the directory holds no readable run.
    """
    from xqmap import build  # build imports ManiSkill, which reading settings does not need

    directory = Path(directory)
    tensors, facts = read(directory / POLICY)
    cfg = settings(facts, directory)
    network = build.qmaps(cfg, facts["pixel_size"])
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise UserError(f"{directory / POLICY} does not fit its own settings ({str(error).splitlines()[0]}): train again") from None
    return Run(directory, cfg, GreedyPolicy(network).eval(), facts.get("noise", {}), facts["sha256"])


def settings(facts: dict[str, Any], directory: Path) -> DictConfig:
    """The training's configuration, as stored beside the tensors."""
    try:
        cfg = OmegaConf.create(facts["config"])
    except (KeyError, OmegaConfBaseException) as error:
        raise UserError(f"{directory} carries no readable settings ({error}): train again") from None
    if not isinstance(cfg, DictConfig):
        raise UserError(f"{directory} carries no readable settings: train again")
    return cfg
