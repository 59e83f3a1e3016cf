"""From settings to objects: the only caller of ``hydra.utils.instantiate``, and the one place where networks get their
sizes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from xqmap.config import plugins, schema
from xqmap.data.replay import Replay
from xqmap.data.samplers import PrioritySampler
from xqmap.envs.maniskill import ManiSkillEnv
from xqmap.errors import UserError
from xqmap.explanations.perception import Perception
from xqmap.models.context import Context
from xqmap.models.policy import EpsilonGreedy
from xqmap.models.qmaps import QMaps
from xqmap.models.unet import LocalGeometry, UNet
from xqmap.objectives import DecomposedDQNLoss
from xqmap.objectives.kept import Kept


def device(cfg: DictConfig) -> torch.device:
    """The device the networks live on."""
    if cfg.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if cfg.device == "cuda" and not torch.cuda.is_available():
        raise UserError("device=cuda, but torch sees no GPU: set device=cpu or device=auto")
    return torch.device(cfg.device)


def bf16(cfg: DictConfig) -> bool:
    """Whether updates run in bfloat16: where asked for, or where the machine multiplies it natively."""
    if cfg.trainer.precision != "auto":
        return bool(cfg.trainer.precision == "bf16")
    if device(cfg).type == "cuda":
        return torch.cuda.is_bf16_supported()
    return bool(torch.cpu._is_avx512_bf16_supported())


def task(cfg: DictConfig) -> Any:
    """The world of ``cfg.task.env`` with the task's weights.

    Raises:
        UserError: if its ``_target_`` is not the world of an installed package, or refuses a setting.
    """
    return _installed(cfg.task.env, "task.env", plugins.worlds().values(), weights=dict(cfg.task.weights))


def world(cfg: DictConfig) -> type:
    """The class of the world of ``cfg.task.env``.

    Raises:
        UserError: if its ``_target_`` is not the world of an installed package, or cannot be imported.
    """
    return _installed_class(_content(cfg.task.env), "task.env", plugins.worlds().values())


def perception(settings: DictConfig) -> Perception:
    """What names the objects of a scene; see ``conf/explain/perception``.

    Raises:
        UserError: if its ``_target_`` is not a perception of an installed package, or refuses a setting.
    """
    return _installed(settings, "perception", plugins.perceptions())


def practice(cfg: DictConfig) -> DictConfig:
    """The same settings with training's scenes: ``task.practice`` in the place of what ``task.env`` says."""
    # Resolved first: it may refer to what it takes the place of.
    changes = OmegaConf.to_container(cfg.task.practice, resolve=True)
    return OmegaConf.merge(cfg, {"task": {"env": changes}})  # type: ignore[return-value]


def make_env(cfg: DictConfig, first_scene: int) -> Callable[[], ManiSkillEnv]:
    """A function that builds the environment where it is called: in this process or in a worker.

    It raises UserError where ``task.components`` are not the world's ``REWARD_COMPONENTS`` in their order.
    """
    names = [str(name) for name in cfg.task.components]
    weights = dict(zip(names, schema.weights_in_order(cfg.task.weights, names), strict=True))
    limit = cfg.trainer.decision_limit
    return partial(ManiSkillEnv, partial(task, cfg), first_scene=first_scene, limit=limit, weights=weights)


def qmaps(cfg: DictConfig, pixel_size: float) -> QMaps:
    """The K untrained U-Nets of ``cfg.method`` and ``cfg.qnet``, for cells of ``pixel_size`` metres."""
    return _untrained(cfg, pixel_size).to(device(cfg), memory_format=torch.channels_last)


def shapes(cfg: DictConfig, pixel_size: float) -> dict[str, torch.Size]:
    """The shapes of the tensors of :func:`qmaps`, by name, found without taking memory for them."""
    with torch.device("meta"):
        return {name: tensor.shape for name, tensor in _untrained(cfg, pixel_size).state_dict().items()}


def _untrained(cfg: DictConfig, pixel_size: float) -> QMaps:
    stem = LocalGeometry(
        pixel_size, cfg.qnet.height_scale, list(cfg.qnet.plane_windows), cfg.qnet.surroundings, cfg.qnet.slope_scale
    )
    # Where nothing follows there is nothing that a context could say.
    size = cfg.qnet.context if cfg.loss.gamma > 0 else 0
    context = Context(size, cfg.qnet.height_scale, cfg.qnet.raised_height) if size else None
    unet = partial(UNet, width=cfg.qnet.width, depth=cfg.qnet.depth, context=size, horizon=cfg.qnet.horizon)
    # A task whose transitions may be turned and mirrored is decided on from all sides, too.
    return QMaps(
        cfg.method.components, stem, unet, cfg.method.weights, cfg.replay.augment, context, float(cfg.loss.gamma)
    )


def replay(cfg: DictConfig) -> Replay:
    """The empty replay buffer of ``cfg.replay``; next states are kept where ``loss.gamma`` needs them."""
    kept = cfg.replay
    sampler = PrioritySampler(kept.capacity, kept.alpha, kept.beta_init, kept.beta_end) if kept.alpha > 0 else None
    return Replay(
        kept.capacity, cfg.trainer.batch_size, kept.augment, cfg.loss.gamma > 0, cfg.seed, kept.on_disk, sampler
    )


def exploration(cfg: DictConfig) -> EpsilonGreedy:
    """ε-greedy around the greedy policy, with a generator of its own."""
    return EpsilonGreedy(**cfg.exploration, seed=cfg.seed)


def loss(cfg: DictConfig, network: QMaps, kept: Kept | None = None) -> DecomposedDQNLoss:
    """The TD loss of ``cfg.method`` and ``cfg.loss``, its keys and estimator set, and what is ``kept`` of next
    states.
    """
    module = DecomposedDQNLoss(
        network,
        components=cfg.method.components,
        double_dqn=cfg.loss.double_dqn,
        loss_function=cfg.loss.loss_function,
        shared_argmax=cfg.method.shared_argmax,
        kept=kept,
    )
    module.set_keys(reward=cfg.method.reward_key)
    module.make_value_estimator(gamma=cfg.loss.gamma)
    return module


def _installed(settings: Any, where: str, known: Collection[str], **extra: Any) -> Any:
    """Builds the one class that ``settings`` name. A stranger's run directory can name any callable: only what the
    settings of installed packages name is ever called.
    """
    content = _content(settings)
    _installed_class(content, where, known)
    if inner := [name for value in content.values() for name in _targets(value)]:
        raise UserError(f"{where} names {inner[0]!r} inside its settings: only its own _target_ is run")
    if words := [name for name in content if str(name).startswith("_") and name != "_target_"]:
        raise UserError(f"{where}.{words[0]} is no setting: take it away")
    try:
        return instantiate(content, **extra, _convert_="all", _recursive_=False)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, ValueError | TypeError | OverflowError):
            # An error that says which setting it is about (``setting``) begins with that setting's name.
            raise UserError(f"{where}{'.' if hasattr(cause, 'setting') else ': '}{cause}") from None
        raise


def _content(settings: Any) -> Any:
    return OmegaConf.to_container(settings, resolve=True) if OmegaConf.is_config(settings) else settings


def _installed_class(content: Any, where: str, known: Collection[str]) -> type:
    target = content.get("_target_") if isinstance(content, dict) else None
    if not isinstance(target, str) or target not in known:
        raise UserError(
            f"{where} names {target!r}, which no installed package offers: install the one that does (known are "
            f"{', '.join(sorted(known))})"
        )
    return plugins.load(target)


def _targets(settings: Any) -> list[str]:
    if isinstance(settings, dict):
        own = [str(settings["_target_"])] if "_target_" in settings else []
        return own + [target for value in settings.values() for target in _targets(value)]
    if isinstance(settings, list):
        return [target for value in settings for target in _targets(value)]
    return []
