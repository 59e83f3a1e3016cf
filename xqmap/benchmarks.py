"""What is measured against what: each fast path beside its plain reference, in one run, alternating."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from omegaconf import DictConfig
from tensordict import TensorDict
from tqdm import tqdm

from xqmap import build, evaluation, keys
from xqmap.envs.heightmap import PixelGrid, heightmap
from xqmap.explanations.perception import Simulator, agreement
from xqmap.objectives import DecomposedDQNLoss

# The tabletop of Ravens: the larger of the two maps.
ROWS, COLUMNS, BATCH, PIXEL_SIZE = 320, 160, 16, 0.003125


def alternating(first: Callable[[], Any], second: Callable[[], Any], rounds: int) -> tuple[float, float]:
    """Median seconds of two functions, called in turn after one call each to warm up."""
    seconds: tuple[list[float], list[float]] = ([], [])
    first(), second()
    for _ in tqdm(range(rounds), unit="round", desc="measuring"):
        for function, taken in ((first, seconds[0]), (second, seconds[1])):
            start = time.perf_counter()
            function()
            taken.append(time.perf_counter() - start)
    return statistics.median(seconds[0]), statistics.median(seconds[1])


def update(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """One gradient step: full maps in fp32, net after net, against windows, channels-last and (where native) bf16."""
    torch.manual_seed(0)
    done = torch.zeros(BATCH, 1, dtype=torch.bool)
    count = len(cfg.method.components)
    following = {keys.HEIGHTMAP: torch.rand(BATCH, 4, ROWS, COLUMNS), cfg.method.reward_key: torch.rand(BATCH, count)}
    following |= {keys.DONE: done, keys.TERMINATED: done}
    state = {keys.HEIGHTMAP: torch.rand(BATCH, 4, ROWS, COLUMNS), keys.ACTION: torch.randint(ROWS * COLUMNS, (BATCH,)), "next": following}
    batch = TensorDict(state, batch_size=[BATCH])

    def step(windowed: bool, bf16: bool) -> Callable[[], None]:
        network = build.qmaps(cfg, PIXEL_SIZE).cpu()
        if not windowed:
            network = network.to(memory_format=torch.contiguous_format)
        loss = DecomposedDQNLoss(network, components=cfg.method.components, windowed=windowed)
        loss.set_keys(reward=cfg.method.reward_key)
        loss.make_value_estimator(gamma=0.9)
        parameters = [p for p in loss.parameters() if p.requires_grad]
        optimizer = torch.optim.Adam(parameters)

        def run() -> None:
            with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
                losses = loss(batch.clone(False))
            optimizer.zero_grad()
            torch.stack([losses[f"loss_{name}"] for name in cfg.method.components]).sum().backward()
            optimizer.step()

        return run

    dense, ours = alternating(step(False, False), step(True, build.bf16(cfg)), rounds)
    return {"dense_s": dense, "ours_s": ours, "ratio": dense / ours, "bf16": build.bf16(cfg), "map": [ROWS, COLUMNS], "batch": BATCH}


def fusion(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Three 640 × 480 views into one map: the published algorithm in plain numpy against :func:`xqmap.envs.heightmap.heightmap`."""
    generator = torch.Generator().manual_seed(0)
    grid = PixelGrid([[0.25, 0.75], [-0.5, 0.5], [0.0, 0.28]], PIXEL_SIZE)
    color = torch.randint(1, 256, (3, 480, 640, 3), dtype=torch.uint8, generator=generator)
    depth = 0.70 + 0.05 * torch.rand(3, 480, 640, generator=generator)
    intrinsics = torch.tensor([[450.0, 0, 320], [0, 450, 240], [0, 0, 1]]).repeat(3, 1, 1)
    pose = torch.eye(4).repeat(3, 1, 1)
    pose[:, :3, :3] = torch.tensor([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]])
    pose[:, :3, 3] = torch.tensor([[0.5, 0.0, 0.75], [0.5, 0.2, 0.75], [0.5, -0.2, 0.75]])
    plain, ours = alternating(
        lambda: plain_heightmap(color.numpy(), depth.numpy(), intrinsics.numpy(), pose.numpy(), grid),
        lambda: heightmap(color, depth, intrinsics, pose, grid),
        rounds,
    )
    expected = plain_heightmap(color.numpy(), depth.numpy(), intrinsics.numpy(), pose.numpy(), grid)
    same = np.abs(heightmap(color, depth, intrinsics, pose, grid).numpy()[3] - expected) < 1e-3
    return {"plain_s": plain, "ours_s": ours, "ratio": plain / ours, "same_heights": float(same.mean())}


def plain_heightmap(color: np.ndarray, depth: np.ndarray, intrinsics: np.ndarray, pose: np.ndarray, grid: PixelGrid) -> np.ndarray:
    """Heights ``[H, W]`` as Ravens describes it: per camera unproject, keep what is inside, write in order of z; then the maximum."""
    low, high = np.array(grid.bounds).T
    maps = []
    for image, metres, k, to_world in zip(color, depth, intrinsics, pose, strict=True):
        h, w = metres.shape
        u, v = np.meshgrid(np.arange(w), np.arange(h))
        points = np.stack(((u - k[0, 2]) * metres / k[0, 0], (v - k[1, 2]) * metres / k[1, 1], metres), axis=-1).reshape(-1, 3)
        points = (to_world @ np.column_stack((points, np.ones(len(points)))).T).T[:, :3]
        kept = ((points >= low) & (points < high)).all(1)
        points, shades = points[kept], image.reshape(-1, 3)[kept]
        order = np.argsort(points[:, 2], kind="stable")
        points, shades = points[order], shades[order]
        column = np.floor((points[:, 0] - low[0]) / grid.pixel_size).astype(int).clip(0, grid.shape[1] - 1)
        row = np.floor((points[:, 1] - low[1]) / grid.pixel_size).astype(int).clip(0, grid.shape[0] - 1)
        height, colors = np.zeros(grid.shape), np.zeros((*grid.shape, 3), dtype=np.uint8)
        height[row, column] = points[:, 2] - low[2]
        colors[row, column] = shades
        maps.append(height)
    return np.max(maps, axis=0)


def env(cfg: DictConfig, see: DictConfig, rounds: int) -> dict[str, Any]:
    """Whole decisions of random pixels in the task, and where their time goes."""
    world = build.make_env(cfg, first_scene=evaluation.training_scenes(cfg.seed))()
    generator = torch.Generator().manual_seed(0)
    before, start, made = world.seconds, time.perf_counter(), 0
    try:
        with tqdm(total=rounds, unit="decision", desc="deciding") as bar:
            while made < rounds:
                state, done = world.reset(), False
                while not done and made < rounds:
                    state[keys.ACTION] = torch.tensor(evaluation.random_pixel(state, world, generator))
                    following = world.step(state)["next"]
                    state, done, made = following.exclude("reward"), bool(following[keys.DONE]), made + 1
                    bar.update()
        total, spent = time.perf_counter() - start, world.seconds
    finally:
        world.close()
    return {"decisions": made, "decisions_per_s": made / total} | {f"share_{n}": (spent[n] - before[n]) / total for n in spent}


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
    "perception": Benchmark(perception, 200),
}


def machine() -> dict[str, Any]:
    """What the numbers were measured on."""
    return {"processors": os.cpu_count(), "torch_threads": torch.get_num_threads(), "torch": torch.__version__}
