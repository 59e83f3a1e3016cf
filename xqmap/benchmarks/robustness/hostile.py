"""Files and settings of someone who means harm: every one must be refused by name, and nothing of it run."""

from __future__ import annotations

import copy
import json
import os
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from xqmap.config import build
from xqmap.errors import UserError
from xqmap.evaluation import file as evaluation
from xqmap.explanations import Decision
from xqmap.runs import checkpoint
from xqmap.runs.run import load_run

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


def places(folder: Path) -> Iterator[Path]:
    """Places in ``folder`` where a file is expected and none is: a pipe, devices, a folder, links in a circle, a file
    that only claims to be large.
    """
    for name, there in {"device": "/dev/zero", "terminal": "/dev/tty", "circle": "circle"}.items():
        (folder / name).symlink_to(there)
        yield folder / name
    os.mkfifo(folder / "pipe")
    yield folder / "pipe"
    (folder / "folder").mkdir()
    yield folder / "folder"
    with open(folder / "large", "wb") as file:
        file.truncate(2**40)
    yield folder / "large"


def refused_places(folder: Path) -> tuple[int, int]:
    """At how many places each reader of files was sent, and how often it refused at once."""
    folder.mkdir()
    tried = refused = 0
    for place in places(folder):
        for read in (Decision.load, load_run, checkpoint.read, evaluation.read):
            tried += 1
            door = place
            if read is load_run:  # a single policy is known by its ending
                door = place.with_name(f"{place.name}.safetensors")
                door.symlink_to(place)
            try:
                read(door)  # type: ignore[operator]
            except UserError:
                refused += 1
    return tried, refused


def crowds(facts: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The facts of a policy with more of something than anybody has."""
    many = [f"c{i}" for i in range(100_000)]
    deep: list[Any] = []
    for _ in range(900):
        deep = [deep]
    for place, value in {
        "task.components": many,
        "method.components": many,
        "method.weights": [1.0] * 100_000,
        "task.weights": dict.fromkeys(many, 1.0),
        "task.env.blocks": deep,
        "task.name": "x" * 1_000_000,
        "qnet.plane_windows": list(range(3, 10_003, 2)),
        "qnet.width": 10**9,
        "evaluation.seeds": list(range(1_000_000)),
    }.items():
        changed = copy.deepcopy(facts)
        part, name = place.rsplit(".", 1)
        inner = changed["config"]
        for key in part.split("."):
            inner = inner[key]
        inner[name] = value
        yield changed


def refused_crowds(file: Path) -> tuple[int, int]:
    """How many policies like ``file`` name too much of something, and how many of them are refused."""
    tensors, facts = checkpoint.read(file)
    tried = refused = 0
    crowded = file.with_name("crowded.safetensors")
    for changed in crowds(facts):
        checkpoint.write(crowded, tensors, changed)
        tried += 1
        try:
            load_run(crowded)
        except UserError:
            refused += 1
    crowded.unlink()
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
