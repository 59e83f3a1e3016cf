"""What a notebook needs, as ``import xqmap`` offers it: load an agent, make its world, decide, say why, show, ask,
play, learn.

    import xqmap

    agent = xqmap.load("pretrained/landing")
    env = xqmap.make_env(agent, scene=3)
    state = env.reset()
    decision = xqmap.decide(agent, env, state)
    print(xqmap.why(decision))
    xqmap.show(decision).savefig("why.png")
    print(xqmap.ask(decision, "Why not the ground?"))
    state = xqmap.play(env, state, decision)
    print(xqmap.rewards(env, state))
"""

from __future__ import annotations

from pathlib import Path

import torch
from hydra import compose, initialize_config_dir
from matplotlib.figure import Figure
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase

from xqmap import doctor, keys
from xqmap.config import arguments, build, plugins, schema
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.views import plots
from xqmap.explanations.views.sentences import why as why
from xqmap.explanations.views.sentences import wording_for
from xqmap.runs import checkpoint, locks
from xqmap.runs.decide import cell, decide_on
from xqmap.runs.run import Run, load_run

load = load_run


def settings(task: str, *changes: str) -> DictConfig:
    """The settings of a training, as ``python -m xqmap.train +task=TASK`` has them.

    Args:
        task: the name of an installed world.
        changes: as on the command line: ``"trainer=smoke"``, ``"task.weights.color=2"``.

    Raises:
        UserError: if a setting is unknown or out of its range.
        hydra.errors.HydraException: if a change cannot be read.
    """
    schema.register()
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        cfg = compose("config", [f"+task={task}", *changes])
    schema.validate(cfg)
    return cfg


def make_env(agent: Run | str, *changes: str, scene: int = 0) -> ManiSkillEnv:
    """The world of an agent, or of a task by name, as a torchrl environment.

    Args:
        agent: a loaded run; or the name of an installed world.
        changes: of its settings, as on the command line; for a world by name.
        scene: seed of the first scene; each reset takes the next one.

    Raises:
        UserError: if nothing can be drawn here, or a setting is refused.
    """
    if isinstance(agent, Run) and changes:
        raise UserError("an agent's world is as it was trained: change the settings of a world by its name")
    cfg = agent.cfg if isinstance(agent, Run) else settings(agent, *changes)
    doctor.require_rendering(build.world(cfg))
    return build.make_env(cfg, first_scene=scene)()


def decide(
    agent: Run,
    env: ManiSkillEnv,
    state: TensorDictBase,
    perception: str = "simulator",
    candidates: str = "pixel",
    step: int = 0,
) -> Decision:
    """What the agent chooses in the present state, and every number of it.

    Args:
        agent: whose policy decides.
        env: the world, in that state.
        state: what its ``reset`` or :func:`play` returned.
        perception: what names the objects, a file of ``conf/explain/perception``.
        candidates: what A, B, … are the best of for one component alone: every ``"pixel"`` or every ``"object"``.
        step: how many decisions of the episode went before.
    """
    see = build.perception(OmegaConf.create(plugins.perception(perception)))
    return decide_on(agent, env, state, see, candidates, step)


def show(decision: Decision) -> Figure:
    """Q-Maps, bars and sentences in one picture; a notebook shows it, ``.savefig(path)`` keeps it."""
    return plots.overview(decision)


def ask(decision: Decision, question: str) -> str:
    """The answer to a question in one's own words, from the decision's numbers alone."""
    return Dialogue(decision, wording_for(decision.task)).ask(question).answer


def play(env: ManiSkillEnv, state: TensorDictBase, action: Decision | int) -> TensorDictBase:
    """Carries an action out.

    Args:
        env: the world.
        state: its present state.
        action: a decision, whose choice is played; or a cell, row · W + column.

    Returns:
        The state after it, with ``reward``, ``reward_components`` and ``done``.
    """
    chosen = cell(action, env) if isinstance(action, Decision) else action
    after: TensorDictBase = env.step(state.clone(False).set(keys.ACTION, torch.tensor(chosen)))["next"]
    return after


def rewards(env: ManiSkillEnv, state: TensorDictBase) -> dict[str, float]:
    """What the action before ``state`` was paid, by component."""
    return dict(zip(env.components, state[keys.REWARD_COMPONENTS].tolist(), strict=True))


def learn(task: str, *changes: str, out: str | Path) -> Run:
    """Trains an agent, as ``python -m xqmap.train`` does, without its evaluation.

    Args:
        task: the name of an installed world.
        changes: of the settings, as on the command line: ``"trainer.frames=500"``.
        out: the run directory to make.

    Raises:
        UserError: if ``out`` holds a run, or a setting is refused.
    """
    # Late: it brings wandb and all that draws, a second that loading and asking need not wait for.
    from xqmap.trainers import training

    cfg, directory = settings(task, *changes), Path(out)
    if (directory / checkpoint.POLICY).exists():
        raise UserError(f"{directory} already holds a run: choose another out")
    doctor.require_rendering(build.world(cfg))
    directory.mkdir(parents=True, exist_ok=True)
    with locks.alone(directory):
        training.train(cfg, directory, None, {"config": cfg}, arguments.command("train", resume=directory))
    return load(directory)
