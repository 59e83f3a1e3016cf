"""``python -m xqmap.film run=DIR scene_seed=N``: the robot carries out what the policy chooses, as a video."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import torch
from omegaconf import DictConfig, OmegaConf
from torchrl.envs.utils import step_mdp
from tqdm import tqdm

from xqmap import doctor, keys
from xqmap.config import build, cli
from xqmap.errors import UserError
from xqmap.evaluation import play
from xqmap.runs import checkpoint


def film(cfg: DictConfig) -> None:
    """Plays ``cfg.steps`` decisions of the scene and writes ``cfg.out``, an mp4 file."""
    run = checkpoint.load_run(cli.required(cfg, "run", "run=DIR, a directory that python -m xqmap.train left"))
    steps = cli.decisions(cfg)
    out = Path(cfg.out) if cfg.out else Path(f"{run.cfg.task.name}-scene{cfg.scene_seed}.mp4")
    if out.suffix != ".mp4":
        raise UserError(f"out={out} must end with .mp4")
    checkpoint.require_place(out)
    doctor.require_rendering()
    settings = OmegaConf.merge(run.cfg, {"task": {"env": {"render_mode": "rgb_array"}}})
    assert isinstance(settings, DictConfig)
    env = build.make_env(settings, first_scene=cfg.scene_seed)()
    choose = play.greedy(run.policy)
    beside = out.with_name(f".{out.name}.part.mp4")
    out.parent.mkdir(parents=True, exist_ok=True)
    made, frames, video = 0, 0, None
    try:
        with tqdm(total=steps, unit="decision", desc="filming") as bar:
            state, done = env.reset(), False
            while not done and (steps is None or made < steps):
                state[keys.ACTION] = torch.tensor(choose(state, env, torch.default_generator))
                state = env.step(state)
                for frame in env.task.frames:
                    if video is None:
                        video = _writer(beside, frame, env.task.frame_rate)
                    video.send(np.ascontiguousarray(frame))
                made, frames = made + 1, frames + len(env.task.frames)
                done, state = bool(state["next", keys.DONE]), step_mdp(state)
                bar.update()
        if video is None:
            raise UserError(f"{run.cfg.task.name} gave no pictures of its robot: nothing was filmed")
        video.close()
        os.replace(beside, out)
    finally:
        beside.unlink(missing_ok=True)
        env.close()
    print(f"wrote {out}: {made} decisions, {frames / env.task.frame_rate:.1f} s")


def _writer(path: Path, frame: np.ndarray, rate: float) -> Any:
    """What takes frames like ``frame`` ``[h, w, 3]`` for an H.264 video of ``rate`` frames a second."""
    height, width, _ = frame.shape
    video = imageio_ffmpeg.write_frames(str(path), (width, height), fps=rate, macro_block_size=2)
    video.send(None)
    return video


main = cli.main("film")(film)

if __name__ == "__main__":
    main()
