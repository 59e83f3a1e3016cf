"""Where a run's files lie, and where what is made from it belongs; nothing here reads them."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from xqmap.errors import UserError

# The newest policy, the one that chose best among the last training decisions, and what it takes to go on from a
# decision.
POLICY = Path("checkpoint/policy.safetensors")
BEST = Path("checkpoint/best.safetensors")
TRAINING = "checkpoint/training-{:06d}.safetensors"
# Run directories that ship with the package: ``run=pretrained/<task>``.
PRETRAINED = Path(__file__).resolve().parents[1] / "pretrained"


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


def home(place: str | Path) -> Path:
    """Where what is made from a run belongs: its directory, the folder of the same name beside a single policy file,
    or, of an agent that ships with the package, the current directory.
    """
    place = locate(place)
    if place.resolve().is_relative_to(PRETRAINED):
        return Path()
    return place.with_suffix("") if place.suffix == ".safetensors" else place


def default_folder(cfg: DictConfig, name: str) -> Path:
    """Where a command writes that was not told: in the run's figures; of a decision file, which may be a stranger's, in
    the current directory.
    """
    if cfg.decision is not None:
        return Path(name)
    scene = f"scene{cfg.scene_seed}" if cfg.images is None else Path(cfg.images).stem or "images"
    return home(cfg.run) / "figures" / scene
