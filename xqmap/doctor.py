"""``python -m xqmap.doctor``: is this machine fit to train? One line per thing: ok, or what to do."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from omegaconf import DictConfig

from xqmap.config import cli
from xqmap.errors import UserError
from xqmap.terminal import say

# A checkout has what sets a machine up; an installed package has not.
_CHECKOUT = (Path(__file__).parents[1] / "Makefile").exists()
FIX_VULKAN = (
    "run 'make setup' (it installs Mesa's CPU driver), or install a Vulkan driver: Mesa lavapipe 24.3 or newer does"
    if _CHECKOUT
    else "as root, 'apt-get update' and 'apt-get install -y mesa-vulkan-drivers libvulkan1' (on Debian 12 with "
    "'-t bookworm-backports'), or install another Vulkan driver: Mesa lavapipe 24.3 or newer does"
)
_FIX_PACKAGES = "run 'make setup'" if _CHECKOUT else "pip install 'xqmap[sim]'"
# Draws one frame in a process of its own, because a broken driver ends the process instead of raising.
_FRAME = """
import numpy, sapien
sapien.render.set_log_level("off")
device = sapien.Device("cuda") if {gpu} else sapien.Device("cpu")
system = sapien.render.RenderSystem(device)
scene = sapien.Scene([sapien.physx.PhysxCpuSystem(), system])
scene.set_ambient_light([1, 1, 1])
builder = scene.create_actor_builder()
builder.add_box_visual(half_size=[1, 1, 1], material=[1, 0, 0])
builder.build_static(name="box").set_pose(sapien.Pose([4, 0, 0]))
camera = scene.add_camera("camera", 32, 32, 1.0, 0.1, 10)
scene.update_render()
camera.take_picture()
image = camera.get_picture("Color")
assert image[16, 16, 3] > image[0, 0, 3], "the frame is empty"
print(sapien.render.get_device_summary().split("GPU:")[1].splitlines()[0].strip(), flush=True)
"""


@dataclass
class Finding:
    """What was found: ``ok``, and one line that says it or the fix; training cannot work without what is ``vital``."""

    name: str
    ok: bool
    line: str
    vital: bool = True


def vulkan() -> Finding:
    """Whether SAPIEN can render a frame here, and on which device."""
    import torch  # not there at all on a machine that needs this command

    command = [sys.executable, "-c", _FRAME.format(gpu=torch.cuda.is_available())]
    try:
        # Seconds on an idle machine; a busy one is not without a driver.
        done = subprocess.run(command, capture_output=True, text=True, timeout=900)
    except subprocess.TimeoutExpired:
        return Finding("vulkan", False, f"drawing one frame took over 15 minutes: {FIX_VULKAN}")
    if done.returncode != 0:
        why = (done.stderr.strip().splitlines() or [f"exit {done.returncode}"])[-1]
        return Finding("vulkan", False, f"no device that can render ({why.strip()[:120]}): {FIX_VULKAN}")
    return Finding("vulkan", True, f"a test frame was rendered on {done.stdout.strip().splitlines()[-1]}")


def packages() -> Finding:
    """Whether the libraries that results depend on are there, and their versions."""
    found, missing = [], []
    for name in ("torch", "torchrl", "tensordict", "mani-skill", "sapien", "hydra-core", "wandb"):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            missing.append(name)
    if missing:
        return Finding("packages", False, f"{', '.join(missing)} not installed: {_FIX_PACKAGES}")
    return Finding("packages", True, ", ".join(found))


def threads() -> Finding:
    """How many threads torch computes with."""
    import torch  # not there at all on a machine that needs this command

    line = f"torch computes with {torch.get_num_threads()} of {os.cpu_count()} processors"
    return Finding("threads", True, f"{line}; a GPU is there" if torch.cuda.is_available() else line, vital=False)


def disk() -> Finding:
    """Free disk where runs are written."""
    free = shutil.disk_usage(".").free / 2**30
    return Finding(
        "disk", free > 1, f"{free:.1f} GiB free here" + ("" if free > 1 else ": a run needs about 1 GiB, free some")
    )


def memory() -> Finding:
    """Memory that is available now."""
    pages = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    return Finding("memory", True, f"{pages:.1f} GiB of memory free", vital=False)


CHECKS: dict[str, Callable[[], Finding]] = {f.__name__: f for f in (vulkan, packages, threads, disk, memory)}


def require_rendering(world: type) -> None:
    """The part of the check-up without which no world of ManiSkill's or SAPIEN's can be drawn; others draw their own
    way.

    Args:
        world: the class of the world.

    Raises:
        UserError: with the fix.
    """
    if not any(base.__module__.partition(".")[0] in ("mani_skill", "sapien") for base in world.__mro__):
        return
    finding = vulkan()
    if not finding.ok:
        raise UserError(finding.line)


def doctor(cfg: DictConfig) -> None:
    """Prints the findings; exits with 1 if training could not work."""
    if cfg.only is not None and cfg.only not in CHECKS:
        raise UserError(f"only={cfg.only} is not one of {', '.join(CHECKS)}")
    findings = [check() for name, check in CHECKS.items() if cfg.only in (None, name)]
    for finding in findings:
        say(f"{'ok ' if finding.ok else 'FIX'} {finding.name}: {finding.line}")
    if any(not finding.ok and finding.vital for finding in findings):
        sys.exit(1)


main = cli.main("doctor")(doctor)

if __name__ == "__main__":
    main()
