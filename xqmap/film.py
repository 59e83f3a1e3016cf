"""``python -m xqmap.film run=DIR scene_seed=N``: the robot carries out what the policy chooses, as a video."""

from __future__ import annotations

import dataclasses
from itertools import islice
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from xqmap.config import cli
from xqmap.envs.episode import episode
from xqmap.errors import UserError
from xqmap.evaluation.baselines import greedy
from xqmap.files import replacing, require_place
from xqmap.runs.run import load_run
from xqmap.terminal import say


def film(cfg: DictConfig) -> None:
    """Plays ``cfg.steps`` decisions of the scene and writes ``cfg.out``, an mp4 file."""
    run = load_run(cli.required(cfg, "run", "run=DIR, a directory that python -m xqmap.train left"))
    steps = cli.decisions(cfg)
    out = Path(cfg.out) if cfg.out else Path(f"{run.cfg.task.name}-scene{cfg.scene_seed}.mp4")
    if out.suffix != ".mp4":
        raise UserError(f"out={out} must end with .mp4")
    require_place(out)
    settings = OmegaConf.merge(run.cfg, {"task": {"env": {"render_mode": "rgb_array"}}})
    assert isinstance(settings, DictConfig)
    env = dataclasses.replace(run, cfg=settings).make_env(cfg.scene_seed)
    choose = greedy(run.policy)
    made, frames, video = 0, 0, None
    try:
        with replacing(out) as beside, tqdm(total=steps, unit="decision", desc="filming") as bar:
            for _ in islice(episode(env, lambda state: choose(state, env, torch.default_generator)), steps):
                for frame in env.task.frames:
                    if video is None:
                        video = _writer(beside, frame, env.task.frame_rate)
                    video.send(np.ascontiguousarray(frame))
                made, frames = made + 1, frames + len(env.task.frames)
                bar.update()
            if video is None:
                raise UserError(f"{run.cfg.task.name} gave no pictures of its robot: nothing was filmed")
            video.close()
    finally:
        env.close()
    say(f"wrote {out}: {made} decisions, {frames / env.task.frame_rate:.1f} s")


def _writer(path: Path, frame: np.ndarray, rate: float) -> Any:
    """What takes frames like ``frame`` ``[h, w, 3]`` for an H.264 video of ``rate`` frames a second."""
    height, width, _ = frame.shape
    video = imageio_ffmpeg.write_frames(str(path), (width, height), fps=rate, macro_block_size=2)
    video.send(None)
    return video


main = cli.main("film")(film)

if __name__ == "__main__":
    main()
