"""The robustness benchmarks at full size: counts of what was injected, what was survived, and the bytes it cost."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from xqmap.benchmarks.robustness import faults, hostile, interruptions
from xqmap.benchmarks.robustness.soak import soak
from xqmap.errors import UserError
from xqmap.runs import checkpoint
from xqmap.terminal import say

# A training that is short, but has several checkpoints, updates and pictures.
_SHORT = {
    "trainer": {
        "frames": 24,
        "warmup_frames": 8,
        "batch_size": 4,
        "updates_per_frame": 0.5,
        "checkpoint_period": 4,
        "picture_period": 100,
    },
    "qnet": {"width": 4, "depth": 1},
    "logger": {"mode": "disabled"},
}


def _short(cfg: DictConfig) -> DictConfig:
    short = OmegaConf.merge(cfg, _SHORT)
    assert isinstance(short, DictConfig)
    return short


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="xqmap-") as name:
        yield Path(name)


def injected(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Kills a training ``rounds`` times and while it writes, breaks its world, log and disk, and hands it damaged and
    hostile files.
    """
    cfg = _short(cfg)
    with _folder() as folder:
        kills = interruptions.interrupt(cfg, folder, rounds)
        result = {f"kills_{name}": value for name, value in kills.items()}
        expected = checkpoint.read(folder / "alone" / checkpoint.POLICY)[1]["sha256"]
        tried = survived = lost = 0
        for name, fault in tqdm(faults.FAULTS.items(), unit="fault", desc="breaking"):
            directory = folder / name.replace(" ", "-")
            try:
                disk = faults.small_disk(directory, 256) if name in faults.ON_A_DISK else _nothing()
                with disk:
                    held, bytes_lost, _ = faults.suffer(cfg, directory, fault)
                    same = not fault.repeats or checkpoint.read(directory / checkpoint.POLICY)[1]["sha256"] == expected
            except PermissionError:
                say(f"{name}: not tried, mounting a disk takes root")
                continue
            tried, survived, lost = tried + 1, survived + (held and same), lost + bytes_lost
            if not (held and same):
                say(f"{name}: not survived")
        result |= {"faults_injected": tried, "faults_survived": survived, "faults_bytes_lost": lost}
        newest = checkpoint.trainings(folder / "alone")[0]
        for name, (given, refused) in {
            "files": tuple(
                map(
                    sum,
                    zip(
                        *(hostile.refused_files(p, 250) for p in (newest, folder / "alone" / checkpoint.POLICY)),
                        strict=True,
                    ),
                )
            ),
            "settings": hostile.refused_settings(folder),
            "places": hostile.refused_places(folder / "places"),
            "crowds": hostile.refused_crowds(folder / "alone" / checkpoint.POLICY),
        }.items():
            result |= {f"hostile_{name}": given, f"hostile_{name}_refused": refused}
    return result


@contextmanager
def _nothing() -> Iterator[None]:
    yield


def fuzzed(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """``rounds`` cases: of ten, five are decision files, two run directories, one what a report reads, two sets of
    overrides.
    """
    try:
        from xqmap.benchmarks.robustness import fuzz
    except ImportError:
        raise UserError("what=fuzz needs hypothesis: pip install 'xqmap[dev]'") from None
    part = math.ceil(rounds / 10)
    with _folder() as folder:
        interruptions.finish(_short(cfg), folder / "alone")
        counts = {
            "decisions": fuzz.decisions(folder, 5 * part),
            "run_directories": fuzz.run_directories(folder / "alone" / checkpoint.POLICY, folder / "other", 2 * part),
            "reports": fuzz.reports(folder / "reports", part),
            "overrides": fuzz.overrides(2 * part),
        }
    total = {what: sum(count[what] for count in counts.values()) for what in ("cases", "refused", "crashes")}
    return {f"{name}_{what}": number for name, count in counts.items() for what, number in count.items()} | total


# What to run, and how many rounds of it are enough.
ROBUSTNESS = {"faults": (injected, 20), "fuzz": (fuzzed, 10_000), "soak": (soak, 2_000)}
