"""Files and settings of someone who means harm: every one must be refused by name, and nothing of it run."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from xqmap.config import build
from xqmap.errors import UserError
from xqmap.runs import checkpoint

# Callables that would do something; the last of them hide behind trusted names.
TARGETS = (
    "os.system",
    "os.remove",
    "subprocess.run",
    "builtins.exec",
    "builtins.open",
    "pickle.loads",
    "torch.load",
    "importlib.import_module",
    "hydra.utils.instantiate",
    "pathlib.Path.touch",
    "xqmap_tasks",
    "xqmap.",
    "xqmap.nothing.There",
    "xqmap.config.cli.os.system",
    "xqmap.runs.checkpoint.os.remove",
    "xqmap.doctor.subprocess.run",
    "xqmap.doctor.subprocess.Popen",
    "xqmap.config.build.instantiate",
    "xqmap.config.build.importlib.import_module",
    "xqmap.files.write_atomically",
    "xqmap.runs.checkpoint.Path.touch",
    "xqmap.trainers.callbacks.Checkpoints.save",
    "xqmap_tasks.landing.np.save",
    "xqmap_tasks.landing.torch.load",
)


def settings(marker: Path) -> Iterator[dict[str, Any]]:
    """Settings that name each target: by itself, inside a list and inside another's settings."""
    perception = "xqmap.explanations.perception.Simulator"
    for target in TARGETS:
        evil = {"_target_": target, "_args_": [f"touch {marker}"]}
        yield evil
        yield {"_target_": "xqmap_tasks.landing.LandingEnv", "altitude": evil}
        yield {"_target_": perception, "shapes": [{"deep": [evil]}]}
        yield {"_target_": perception, "_partial_": True, "more": {"_target_": perception, "_args_": [evil]}}


def refused_settings(folder: Path) -> tuple[int, int]:
    """How many hostile settings there are, and how many are refused as a task and as a perception without having
    run.
    """
    marker = folder / "was_run"
    tried = refused = 0
    for content in settings(marker):
        cfg = OmegaConf.create({"task": {"env": content, "weights": {}}})
        for make in (lambda at=cfg: build.task(at), lambda at=cfg: build.perception(at.task.env)):  # type: ignore[misc]
            tried += 1
            try:
                make()
            except UserError:
                refused += not marker.exists()
    return tried, refused


def damaged(whole: bytes, count: int, rng: random.Random) -> Iterator[bytes]:
    """Copies of a file that are cut off, have one bit turned, lost or gained bytes, or are no checkpoint at all."""
    yield from (b"", b"not a checkpoint", b"\x80\x04\x95" + whole, json.dumps({"frames": 3}).encode(), b"\xff" * 64)
    for _ in range(count):
        at = rng.randrange(len(whole))
        yield whole[:at]
        yield whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :]
        yield whole[:at] + whole[at + 1 :]
        yield whole[:at] + bytes([rng.randrange(256)]) + whole[at:]
    # The header holds names, shapes and settings: every bit of its first part is turned.
    for at in range(min(200, len(whole))):
        yield whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :]


def refused_files(file: Path, count: int, seed: int = 0) -> tuple[int, int]:
    """How many damaged copies of ``file`` there are, and how many of them are refused."""
    tried = refused = 0
    copy = file.with_name("copy.safetensors")
    for content in damaged(file.read_bytes(), count, random.Random(seed)):
        tried += 1
        copy.write_bytes(content)
        try:
            checkpoint.read(copy)
        except UserError:
            refused += 1
    copy.unlink()
    return tried, refused
