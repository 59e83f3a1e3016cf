"""What is measured against what: each fast path beside its plain reference, in one run, alternating."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictSequential
from torchrl.envs.utils import step_mdp
from torchrl.objectives import HardUpdate
from tqdm import tqdm

from xqmap import keys
from xqmap.benchmarks.references import PlainQMaps, plain_heightmap
from xqmap.benchmarks.timing import Convolutions, alternating, goals, taking
from xqmap.collectors import collect
from xqmap.config import build
from xqmap.envs.heightmap import PixelGrid, heightmap
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.evaluation import play
from xqmap.evaluation.baselines import random_pixel
from xqmap.explanations.perception import Simulator, agreement
from xqmap.models.policy import GreedyPolicy
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import UNet
from xqmap.objectives import DecomposedDQNLoss
from xqmap.objectives.kept import Kept

# The tabletop of Ravens: the larger of the two maps.
ROWS, COLUMNS, BATCH, PIXEL_SIZE = 320, 160, 16, 0.003125
# Settings of trainer.choice_period to compare.
CHOICE_PERIODS = (1, 100)


def transitions(cfg: DictConfig, rows: int = ROWS, columns: int = COLUMNS) -> TensorDict:
    """A batch as the replay buffer gives it: raised boxes of random colors, none of them the last decision of an
    episode.
    """
    done, count = torch.zeros(BATCH, 1, dtype=torch.bool), len(cfg.method.components)
    images = torch.rand(2, BATCH, 4, rows, columns) * torch.tensor([255.0, 255, 255, 0.2]).view(4, 1, 1)
    following = {
        keys.HEIGHTMAP: images[1],
        cfg.method.reward_key: torch.rand(BATCH, count),
        keys.DONE: done,
        keys.TERMINATED: done,
    }
    state = {keys.HEIGHTMAP: images[0], keys.ACTION: torch.randint(rows * columns, (BATCH,)), "next": following}
    state |= {"index": torch.arange(BATCH), keys.SIDE: torch.zeros(BATCH, dtype=torch.int64)}
    return TensorDict(state, batch_size=[BATCH])


def stepping(
    cfg: DictConfig, network: QMaps, bf16: bool, batch: TensorDict, kept: Kept | None = None
) -> Callable[[], None]:
    """One gradient step, as the trainer makes it."""
    loss = DecomposedDQNLoss(network, components=cfg.method.components, kept=kept)
    loss.set_keys(reward=cfg.method.reward_key)
    loss.make_value_estimator(gamma=0.9)
    HardUpdate(loss, value_network_update_interval=cfg.trainer.target_period)
    optimizer = torch.optim.Adam([p for p in loss.parameters() if p.requires_grad])

    def run() -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            losses = loss(batch.clone(False))
        optimizer.zero_grad()
        torch.stack([losses[f"loss_{name}"] for name in cfg.method.components]).sum().backward()
        optimizer.step()

    return run


def update(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """One gradient step: full maps in fp32, contiguous, net after net, against cones, channels-last, in fp32 and (where
    native) bf16; where nothing follows (γ = 0), with the next action chosen anew, and with it kept.
    """
    torch.manual_seed(0)
    network = build.qmaps(cfg, PIXEL_SIZE).cpu()
    unet = partial(UNet, width=cfg.qnet.width, depth=cfg.qnet.depth)
    plain = PlainQMaps(cfg.method.components, network.stem, unet, cfg.method.weights)
    future = transitions(cfg)
    last = future.clone().set(("next", keys.TERMINATED), torch.ones(BATCH, 1, dtype=torch.bool))
    steps = {"dense/gamma=0": stepping(cfg, plain, False, last), "dense/gamma=0.9": stepping(cfg, plain, False, future)}
    for name, bf16 in (("fp32", False), ("bf16", True)):
        if bf16 and not build.bf16(cfg):
            continue
        steps |= {
            f"{name}/gamma=0": stepping(cfg, network, bf16, last),
            f"{name}/gamma=0.9": stepping(cfg, network, bf16, future),
            # For ever: none is due again.
            f"{name}/gamma=0.9, choice kept": stepping(cfg, network, bf16, future, Kept(sys.maxsize)),
        }
    seconds = dict(zip(steps, alternating(*steps.values(), rounds=rounds), strict=True))
    found: dict[str, float] = {f"share_due/choice_period={n}": due(cfg, n) for n in CHOICE_PERIODS}
    least: dict[str, float] = {}
    for name in sorted({name.split("/")[0] for name in steps} - {"dense"}):
        anew, kept = (seconds[f"{name}/gamma=0.9{how}"] for how in ("", ", choice kept"))
        costs = {f"gamma=0.9, choice_period={n}": kept + due(cfg, n) * (anew - kept) for n in CHOICE_PERIODS}
        for what, cost in {"gamma=0": seconds[f"{name}/gamma=0"], **costs}.items():
            found[f"ratio/{name}/{what}"] = seconds[f"dense/{what.split(',')[0]}"] / cost
            least[f"ratio/{name}/{what}"] = 40 if what == "gamma=0" else 20
        for what in ("gamma=0", "gamma=0.9"):
            with Convolutions() as convolutions:
                steps[f"{name}/{what}"]()
            share = f"share_of_conv_peak/{name}/{what}"
            found[share], least[share] = convolutions.seconds(rounds) / seconds[f"{name}/{what}"], 0.5
    return {
        **{f"seconds/{name}": taken for name, taken in seconds.items()},
        **found,
        **{"map": [ROWS, COLUMNS], "batch": BATCH, "components": len(cfg.method.components)},
        "goals": goals(found, least),
    }


def due(cfg: DictConfig, choice_period: int) -> float:
    """The share of sampled transitions whose next action has to be chosen, over a training that keeps choices."""
    generator, kept = np.random.default_rng(0), np.full(cfg.trainer.frames, -choice_period)
    chosen = drawn = 0
    for made in range(round(cfg.trainer.updates_per_frame * cfg.trainer.frames)):
        stored = cfg.trainer.warmup_frames + int(made / cfg.trainer.updates_per_frame)
        places = generator.integers(min(stored, len(kept)), size=cfg.trainer.batch_size)
        missing = places[made - kept[places] >= choice_period]
        kept[missing] = made
        chosen, drawn = chosen + len(missing), drawn + len(places)
    return chosen / max(1, drawn)


def fusion(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Three 640 × 480 views into one map: the published algorithm in plain numpy against
    :func:`xqmap.envs.heightmap.heightmap`.
    """
    grid = PixelGrid([[0.25, 0.75], [-0.5, 0.5], [0.0, 0.28]], PIXEL_SIZE)
    intrinsics = torch.tensor([[450.0, 0, 320], [0, 450, 240], [0, 0, 1]]).repeat(3, 1, 1)
    pose = torch.eye(4).repeat(3, 1, 1)
    pose[:, :3, :3] = torch.tensor([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    pose[:, :3, 3] = torch.tensor([[0.5, 0.0, 0.75], [0.5, 0.2, 0.75], [0.5, -0.2, 0.75]])
    generator = torch.Generator().manual_seed(0)
    color = torch.randint(1, 256, (3, 480, 640, 3), dtype=torch.uint8, generator=generator)
    # A table with blocks of 4 cm, seen from above.
    blocks = torch.rand(3, 12, 16, generator=generator) < 0.2
    depth = 0.7499 - 0.04 * blocks.float().repeat_interleave(40, 1).repeat_interleave(40, 2)

    def plainly() -> np.ndarray:
        return plain_heightmap(color.numpy(), depth.numpy(), intrinsics.numpy(), pose.numpy(), grid)

    plain, ours = alternating(plainly, lambda: heightmap(color, depth, intrinsics, pose, grid), rounds=rounds)
    same = np.abs(heightmap(color, depth, intrinsics, pose, grid).numpy()[3] - plainly()[3]) < 1e-3
    return {
        **{"plain_s": plain, "ours_s": ours, "ratio": plain / ours, "same_heights": float(same.mean())},
        "goals": goals(
            {"ratio": plain / ours, "same_heights": float(same.mean())}, {"ratio": 15, "same_heights": 0.99}
        ),
    }


def scale(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """How costs grow: with the number of components, the map, the simulators, and the objects of the scene."""
    torch.manual_seed(0)
    bf16, found = build.bf16(cfg), {}
    for count in tqdm((1, 2, 4, 8), unit="size", desc="components"):
        several = altered(cfg, {"method.components": [f"c{i}" for i in range(count)], "method.weights": [1.0] * count})
        network, batch = build.qmaps(several, PIXEL_SIZE).cpu(), transitions(several)
        found[f"update_s/components={count}"] = taking(stepping(several, network, bf16, batch), rounds)
    for rows, columns in tqdm(((84, 84), (320, 160), (640, 320)), unit="size", desc="maps"):
        batch = transitions(cfg, rows, columns)
        step = stepping(cfg, build.qmaps(cfg, PIXEL_SIZE).cpu(), bf16, batch)
        found[f"update_s/map={rows}x{columns}"] = taking(step, rounds)
        batch["next", keys.TERMINATED] = torch.ones(BATCH, 1, dtype=torch.bool)
        found[f"gradient_s/map={rows}x{columns}"] = taking(step, rounds)
    for workers in (1, 2):
        found[f"decisions_per_s/workers={workers}"] = _collecting(cfg, workers, 8 * rounds)
    if "objects" in cfg.task.env:
        for objects in (7, 15, 30):
            value = objects if isinstance(cfg.task.env.objects, int) else [objects, objects]
            found[f"decisions_per_s/objects={objects}"] = env(
                altered(cfg, {"task.env.objects": value}), see, 4 * rounds
            )["decisions_per_s"]
    growth = {
        "components 2 to 8": found["update_s/components=8"] / found["update_s/components=2"],
        "gradient, map area × 4": found["gradient_s/map=640x320"] / found["gradient_s/map=320x160"],
        "workers 1 to 2": found["decisions_per_s/workers=2"] / found["decisions_per_s/workers=1"],
    }
    return {
        **found,
        **{f"growth/{name}": value for name, value in growth.items()},
        "goals": goals(growth, {"workers 1 to 2": 1.7}, {"components 2 to 8": 4, "gradient, map area × 4": 1.1}),
    }


def altered(cfg: DictConfig, changes: dict[str, Any]) -> DictConfig:
    """A copy of the settings with some of them changed."""
    cfg = cfg.copy()
    for name, value in changes.items():
        OmegaConf.update(cfg, name, value)
    return cfg


def _collecting(cfg: DictConfig, workers: int, decisions: int) -> float:
    """Decisions a second of that many worker processes, after each has made some to warm up."""
    several = altered(cfg, {"collector.name": "parallel", "collector.workers": workers})
    world = build.make_env(cfg, play.training_scenes(cfg.seed))()
    policy = TensorDictSequential(GreedyPolicy(build.qmaps(cfg, world.grid.pixel_size).cpu()), build.exploration(cfg))
    source = collect.collector(several, world, policy, made=0)
    made, start = 0, 0.0
    try:
        for count, batch in enumerate(collect.batches(source, several.collector)):
            if count == 2 * workers:
                start = time.perf_counter()
            elif count > 2 * workers:
                made += len(batch)
            if made >= decisions:
                return made / (time.perf_counter() - start)
    finally:
        collect.close(source, alone=False)
        world.close()
    raise AssertionError("a collector never ends by itself")


def deciding(world: ManiSkillEnv, decisions: int) -> Iterator[TensorDictBase]:
    """So many steps at random pixels of a world, episode after episode."""
    generator, done = torch.Generator().manual_seed(0), True
    for _ in tqdm(range(decisions), unit="decision", desc="deciding"):
        if done:
            state = world.reset()
        state[keys.ACTION] = torch.tensor(random_pixel(state, world, generator))
        step = world.step(state)
        yield step
        done, state = bool(step["next", keys.DONE]), step_mdp(step)


def env(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Whole decisions of random pixels in the task, and where their time goes."""
    world = build.make_env(cfg, first_scene=play.training_scenes(cfg.seed))()
    before, start = world.seconds, time.perf_counter()
    try:
        made = sum(1 for _ in deciding(world, rounds))
        total, spent = time.perf_counter() - start, world.seconds
    finally:
        world.close()
    return {"decisions": made, "decisions_per_s": made / total} | {
        f"share_{n}": (spent[n] - before[n]) / total for n in spent
    }


def perception(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """How often the perception of the heightmap alone names an object as the simulator does, over that many scenes."""
    look, know = build.perception(see), Simulator()
    world = build.make_env(cfg, first_scene=0)()
    agreeing = compared = 0
    try:
        for _ in tqdm(range(rounds), unit="scene", desc="looking"):
            image = world.reset()[keys.HEIGHTMAP].numpy()
            same, asked = agreement(know(image, world.grid, world.task), look(image, world.grid, None))
            agreeing, compared = agreeing + same, compared + asked
    finally:
        world.close()
    return {"scenes": rounds, "objects": compared, "agreeing": agreeing, "agreement": agreeing / max(1, compared)}


class Benchmark(NamedTuple):
    """What to run with the settings of a training and of a perception, and how many rounds of it are enough."""

    run: Callable[[DictConfig, DictConfig, int], dict[str, Any]]
    rounds: int


BENCHMARKS = {
    "update": Benchmark(update, 7),
    "heightmap": Benchmark(fusion, 15),
    "env": Benchmark(env, 100),
    "scale": Benchmark(scale, 5),
    "perception": Benchmark(perception, 200),
}
