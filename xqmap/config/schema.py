"""Types and ranges of the settings: a wrong name, type or value is refused before anything starts. Defaults live in
``conf/`` only.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from xqmap.config import plugins
from xqmap.errors import UserError


def _bounded(low: float, high: float = float("inf"), above: bool = False) -> Any:
    """A setting without a default, between ``low`` (excluded if ``above``) and ``high``."""
    return field(default=MISSING, metadata={"low": low, "high": high, "above": above})


def _one_of(*choices: str) -> Any:
    return field(default=MISSING, metadata={"choices": choices})


@dataclass
class Task:
    name: str = MISSING
    components: list[str] = MISSING
    weights: dict[str, float] = MISSING
    env: Any = MISSING
    # A world may do without.
    practice: dict[str, Any] = field(default_factory=dict)


@dataclass
class Method:
    name: str = MISSING
    components: list[str] = MISSING
    weights: list[float] = MISSING
    reward_key: str = _one_of("reward", "reward_components")
    shared_argmax: bool = MISSING


@dataclass
class QNet:
    width: int = _bounded(1, 4096)
    depth: int = _bounded(0, 6)
    height_scale: float = _bounded(0, above=True)
    plane_windows: list[int] = MISSING
    surroundings: int = _bounded(3, 255)
    slope_scale: float = _bounded(0, above=True)
    context: int = _bounded(0, 4096)
    horizon: int = _bounded(0, 100)
    raised_height: float = MISSING


@dataclass
class Loss:
    gamma: float = _bounded(0, 1)
    double_dqn: bool = MISSING
    loss_function: str = _one_of("l1", "l2", "smooth_l1")


@dataclass
class Exploration:
    eps_init: float = _bounded(0, 1)
    eps_end: float = _bounded(0, 1)
    annealing_frames: int = _bounded(0)
    raised_share: float = _bounded(0, 1)
    raised_height: float = MISSING


@dataclass
class Collector:
    name: str = _one_of("single", "parallel", "ordered", "ray")
    workers: int = _bounded(1, 1000)
    frames_per_batch: int = _bounded(1)
    episodes_per_batch: int = _bounded(1)


@dataclass
class Replay:
    capacity: int = _bounded(1, 10**9)
    augment: bool = MISSING
    on_disk: bool = MISSING
    alpha: float = _bounded(0, 1)
    beta_init: float = _bounded(0, 1)
    beta_end: float = _bounded(0, 1)


@dataclass
class Trainer:
    frames: int = _bounded(1)
    warmup_frames: int = _bounded(0)
    updates_per_frame: float = _bounded(0)
    batch_size: int = _bounded(1)
    learning_rate: float = _bounded(0, above=True)
    max_grad_norm: float = _bounded(0, above=True)
    target_period: int = _bounded(1)
    choice_period: int = _bounded(1)
    precision: str = _one_of("auto", "fp32", "bf16")
    checkpoint_period: int = _bounded(1)
    keep_last: int = _bounded(1)
    decision_limit: float | None = _bounded(0, above=True)
    picture_period: int = _bounded(1)


@dataclass
class Evaluation:
    seeds: list[int] = MISSING
    choices: int = _bounded(1)
    until: dict[str, float] | None = MISSING
    baselines: bool = MISSING
    controls: bool = MISSING
    calibration: bool = MISSING


@dataclass
class Logger:
    mode: str = _one_of("offline", "online", "disabled")
    project: str = MISSING


@dataclass
class LanguageModel:
    name: str = _one_of("openai", "template")
    base_url: str | None = MISSING
    model: str | None = MISSING
    temperature: float | None = _bounded(0, 2)
    timeout: float = _bounded(0, 86_400, above=True)
    longest: float = _bounded(0, 86_400, above=True)
    retries: int = _bounded(0, 100)
    max_tokens: int | None = _bounded(1, 10**6)
    max_completion_tokens: int | None = _bounded(1, 10**6)


@dataclass
class Schema:
    """The whole configuration of a training."""

    task: Task = MISSING
    method: Method = field(default_factory=Method)
    qnet: QNet = field(default_factory=QNet)
    loss: Loss = field(default_factory=Loss)
    exploration: Exploration = field(default_factory=Exploration)
    collector: Collector = field(default_factory=Collector)
    replay: Replay = field(default_factory=Replay)
    trainer: Trainer = field(default_factory=Trainer)
    evaluation: Evaluation = field(default_factory=Evaluation)
    logger: Logger = field(default_factory=Logger)
    seed: int = _bounded(0, 3000)
    device: str = _one_of("auto", "cpu", "cuda")
    threads: int | None = MISSING
    sheets: list[str] = MISSING
    resume: str | None = MISSING


def register() -> None:
    """Makes the schema, and what installed packages offer, known to Hydra."""
    plugins.register()
    ConfigStore.instance().store(name="schema", node=Schema)


def weights_in_order(weights: Mapping[str, float], components: Sequence[str]) -> list[float]:
    """w_k in the order of the components, whatever the order they were written in; one that is not named weighs 1."""
    return [weights.get(name, 1.0) for name in components]


def from_few(fewest: int, span: int | Sequence[int]) -> ListConfig:
    """A span ``[low, high]``, or a single number, begun at ``fewest`` at the latest."""
    low, high = (span, span) if isinstance(span, int) else span
    return ListConfig([min(fewest, low), high])


# What ``conf`` reckons with; at import, because settings travel to worker processes as they are.
OmegaConf.register_new_resolver("range", lambda start, stop: list(range(start, stop)), replace=True)
OmegaConf.register_new_resolver("in_order", weights_in_order, replace=True)
OmegaConf.register_new_resolver("from_few", from_few, replace=True)


def typed(cfg: DictConfig | ListConfig) -> DictConfig:
    """Stored settings with their types back.

    Raises:
        UserError: if a name or a type is not the schema's.
    """
    try:
        merged = OmegaConf.merge(OmegaConf.structured(Schema), cfg)
    except OmegaConfBaseException as error:
        place = f" ({error.full_key})" if getattr(error, "full_key", None) else ""
        raise UserError(
            f"these settings{place} do not fit this version of xqmap: {str(error).splitlines()[0]}"
        ) from None
    assert isinstance(merged, DictConfig)
    return merged


def language_model(settings: DictConfig) -> DictConfig:
    """The settings of ``conf/llm`` with types.

    Raises:
        UserError: naming the first setting that is unknown, or whose type or range is not the schema's.
    """
    try:
        merged = OmegaConf.merge(OmegaConf.structured(LanguageModel), settings)
    except OmegaConfBaseException as error:
        raise UserError(f"llm.{getattr(error, 'full_key', '')}: {str(error).splitlines()[0]}") from None
    assert isinstance(merged, DictConfig)
    if merged.name != "template":
        _check(LanguageModel, merged, "llm.")
    return merged


# Of a configuration: components, the edges of windows, single values (every evaluation seed is one), their length
# and levels.
_MOST_COMPONENTS = 32
_MOST_WINDOWS = 16
_MOST_VALUES = 25_000
_LONGEST_TEXT = 10_000
_DEEPEST = 20

# What only a training reads: an agent that was trained before a setting of these was thought of plays all the same.
TRAINING_ONLY = ("exploration", "collector", "replay", "trainer", "logger")


def validate(cfg: DictConfig, playing: bool = False) -> None:
    """Checks what types cannot say.

    Args:
        cfg: the whole configuration.
        playing: a saved policy is to be played, so ``TRAINING_ONLY`` settings may be missing.

    Raises:
        UserError: naming the first setting that is missing or out of its range.
    """
    if OmegaConf.is_missing(cfg, "task"):
        raise UserError("no task: add +task=NAME, one of conf/task (+task=landing)")
    _check(Schema, cfg, "", TRAINING_ONLY if playing else ())
    _check(Task, cfg.task, "task.")
    for name in ("task.components", "method.components"):
        components = list(OmegaConf.select(cfg, name))
        if len(components) > _MOST_COMPONENTS:
            raise UserError(f"{name} has {len(components)} entries; {_MOST_COMPONENTS} are the most")
        if not components or len(set(components)) < len(components):
            raise UserError(f"{name}={components} must name at least one component, and none twice")
    for name in ("task.name", "method.name"):
        if not plugins.is_name(str(OmegaConf.select(cfg, name))):
            raise UserError(f"{name}={OmegaConf.select(cfg, name)!r} is no name: letters, digits, _, - and . make one")
    if unknown := set(cfg.task.practice) - (set(cfg.task.env) - {"_target_"}):
        raise UserError(f"task.practice names {sorted(unknown)}, which task.env does not set")
    unknown = set(cfg.task.weights) - set(cfg.task.components)
    if unknown:
        raise UserError(f"task.weights names {sorted(unknown)}; the task's components are {list(cfg.task.components)}")
    if not all(math.isfinite(weight) and weight >= 0 for weight in (*cfg.task.weights.values(), *cfg.method.weights)):
        raise UserError("task.weights must be finite numbers of 0 or more")
    if len(cfg.method.weights) != len(cfg.method.components):
        raise UserError(
            f"method.weights has {len(cfg.method.weights)} numbers for the components {list(cfg.method.components)}"
        )
    if len(cfg.qnet.plane_windows) > _MOST_WINDOWS:
        raise UserError(f"qnet.plane_windows has {len(cfg.qnet.plane_windows)} edges; {_MOST_WINDOWS} are the most")
    if any(edge % 2 == 0 or not 3 <= edge <= 255 for edge in (*cfg.qnet.plane_windows, cfg.qnet.surroundings)):
        raise UserError("qnet.plane_windows and qnet.surroundings must be odd numbers of cells from 3 to 255")
    if cfg.threads is not None and not 1 <= cfg.threads <= 4096:
        raise UserError(f"threads={cfg.threads} must be between 1 and 4096, or null")
    if not playing and not math.isfinite(cfg.exploration.raised_height):
        raise UserError(f"exploration.raised_height={cfg.exploration.raised_height} must be a finite number of metres")
    if not playing and cfg.replay.alpha > 0 and cfg.replay.capacity > 2**24:
        raise UserError(f"replay.capacity={cfg.replay.capacity} must be at most {2**24} where replay.alpha is above 0")
    until = cfg.evaluation.until or {}
    if unknown := set(until) - set(cfg.task.components):
        raise UserError(
            f"evaluation.until names {sorted(unknown)}; the task's components are {list(cfg.task.components)}"
        )
    if not all(math.isfinite(total) and total > 0 for total in until.values()):
        raise UserError("evaluation.until must hold finite numbers above 0")
    if repeated := [seed for seed, times in Counter(cfg.evaluation.seeds).items() if times > 1]:
        raise UserError(f"evaluation.seeds names {repeated[0]} twice: the same scenes again are no more evidence")
    if not cfg.evaluation.seeds:
        raise UserError("evaluation.seeds is empty: give at least one, evaluation.seeds=[0]")
    if any(not 0 <= seed < 10_000 for seed in cfg.evaluation.seeds):
        raise UserError("evaluation.seeds must be between 0 and 9999 (training scenes lie above)")


def small(settings: Any) -> bool:
    """Whether settings, plain values that a stranger may have written, are no more than any training has. To be asked
    before they get their types: that takes a millisecond for each of them.
    """
    counted, under_way = 0, [(settings, 0)]
    while under_way and counted <= _MOST_VALUES:
        value, depth = under_way.pop()
        counted += 1
        if isinstance(value, dict | list):
            if depth > _DEEPEST or len(value) > _MOST_VALUES:
                return False
            inner = [*value, *value.values()] if isinstance(value, dict) else value
            under_way += [(entry, depth + 1) for entry in inner]
        elif isinstance(value, str) and len(value) > _LONGEST_TEXT:
            return False
    return counted <= _MOST_VALUES


def _check(schema: type, cfg: DictConfig, prefix: str, spared: tuple[str, ...] = ()) -> None:
    for item in dataclasses.fields(schema):
        name = prefix + item.name
        if OmegaConf.is_missing(cfg, item.name):
            if prefix.rstrip(".") in spared:
                continue
            raise UserError(f"{name} has no value: give one with {name}=VALUE")
        value = cfg[item.name]
        if isinstance(item.default_factory, type) and dataclasses.is_dataclass(item.default_factory):
            _check(item.default_factory, value, name + ".", spared)
        elif OmegaConf.is_config(value) and name not in ("task", "task.env", "task.practice"):
            parts = value.values() if isinstance(value, DictConfig) else value
            if any(part is None or OmegaConf.is_config(part) for part in parts):
                raise UserError(f"{name}={value} must hold single values")
        limits = item.metadata
        if "choices" in limits and value not in limits["choices"]:
            raise UserError(f"{name}={value} is not one of {', '.join(limits['choices'])}")
        if "low" not in limits or value is None:
            continue
        inside = math.isfinite(value) and limits["low"] <= value <= limits["high"]
        if not inside or (limits["above"] and value == limits["low"]):
            bound = f"above {limits['low']}" if limits["above"] else f"at least {limits['low']}"
            upper = " and finite" if limits["high"] == float("inf") else f" and at most {limits['high']}"
            raise UserError(f"{name}={value} is out of range: it must be {bound}{upper}")
