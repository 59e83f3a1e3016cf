"""What a notebook needs, as ``import xqmap`` offers it: load an agent, make its world, decide, say why, show, ask,
play, train.

    import xqmap

    agent = xqmap.load("pretrained/landing")        # or a run directory
    env = agent.make_env(scene=3)
    state = env.reset()
    decision = agent.decide(state, env)
    decision                                        # in a notebook: the page
    decision.why("B"); decision.ask("how sure are you?"); decision.show()
    state = env.play(state, decision)
    xqmap.train(task="landing", frames=200)         # overrides as keywords or dotted strings
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig, open_dict

from xqmap import doctor
from xqmap.config import arguments, build, plugins, schema
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.runs import begin, locks
from xqmap.runs.run import Run, load_run

load = load_run


def settings(task: str, *changes: str, **named: Any) -> DictConfig:
    """The settings of a training, as ``python -m xqmap.train +task=TASK`` has them.

    Args:
        task: the name of an installed world.
        changes: as on the command line: ``"trainer=smoke"``, ``"task.weights.color=2"``.
        named: the same by keyword; a setting that only one group has goes by its own name: ``frames=200`` is
            ``trainer.frames=200``.

    Raises:
        UserError: if a setting is unknown or out of its range.
        hydra.errors.HydraException: if a change cannot be read.
    """
    cfg, _ = _composed(task, changes, named)
    return cfg


def make_env(task: str, *changes: str, scene: int = 0, **named: Any) -> ManiSkillEnv:
    """A world without an agent, as a torchrl environment; ``agent.make_env`` makes that of an agent.

    Args:
        task: the name of an installed world.
        changes: of its settings, as in :func:`settings`.
        scene: seed of the first scene; each reset takes the next one.
        named: the same by keyword.

    Raises:
        UserError: if nothing can be drawn here, or a setting is refused.
    """
    cfg = settings(task, *changes, **named)
    doctor.require_rendering(build.world(cfg))
    return build.make_env(cfg, first_scene=scene)()


def train(task: str, *changes: str, out: str | Path | None = None, **named: Any) -> Run:
    """Trains an agent, as ``python -m xqmap.train`` does; ``python -m xqmap.evaluate run=DIR`` says how good it is.

    Args:
        task: the name of an installed world.
        changes: of the settings, as in :func:`settings`.
        out: the run directory to make; where it is not given, the command's own (``hydra.run.dir``).
        named: the same by keyword.

    Returns:
        The agent; its ``directory`` is where it lies.

    Raises:
        UserError: if ``out`` holds a run, or a setting is refused.
    """
    cfg, place = _composed(task, changes, named)
    directory = Path(place if out is None else out)
    begin.require_new(directory, "out")
    begin.require_ready(cfg)
    # Late: it brings wandb and all that draws, a second that loading and asking need not wait for.
    from xqmap.trainers import training

    directory.mkdir(parents=True, exist_ok=True)
    with locks.alone(directory):
        training.train(cfg, directory, None, {"config": cfg}, arguments.command("train", resume=directory))
    return load(directory)


def _composed(task: str, changes: tuple[str, ...], named: dict[str, Any]) -> tuple[DictConfig, str]:
    """The validated settings, and the run directory that the command would make."""
    schema.register()
    given = [*changes, *(f"{_full(name)}={_written(value)}" for name, value in named.items())]
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        cfg = compose("config", [f"+task={task}", *arguments.literal(given)], return_hydra_config=True)
    place = str(cfg.hydra.run.dir)
    with open_dict(cfg):
        del cfg["hydra"]
    schema.validate(cfg)
    return cfg, place


def _full(name: str) -> str:
    """A setting's whole name."""
    groups = {item.name: item.default_factory for item in dataclasses.fields(schema.Schema)}
    if name in groups:
        return name
    found = [
        f"{group}.{name}"
        for group, kind in groups.items()
        if isinstance(kind, type) and name in {item.name for item in dataclasses.fields(kind)}
    ]
    if len(found) != 1:
        raise UserError(
            f"{name} is {'both ' + ' and '.join(found) if found else 'no setting'}: give it as on the command line, "
            f'"{found[0] if found else "trainer.frames"}=VALUE"'
        )
    return found[0]


def _written(value: Any) -> str:
    """A value as Hydra reads it."""
    if isinstance(value, str | Path):
        return QuotedString(str(value), Quote.single).with_quotes()
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_written, value))}]"
    if isinstance(value, dict):
        return f"{{{','.join(f'{key}:{_written(entry)}' for key, entry in value.items())}}}"
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
