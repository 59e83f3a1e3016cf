"""What several tests share: the toy world, and settings to train in it."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, open_dict

from tests.toy import ToyTask
from xqmap.config import plugins, schema


def toy_settings(*overrides: str) -> DictConfig:
    """Settings of a training in the toy world, with ``key=value`` changes."""
    schema.register()
    small = ["qnet.width=8", "qnet.depth=1", "logger.mode=disabled", "trainer.precision=fp32", "evaluation.seeds=[0,1]"]
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        cfg = compose("config", ["+task=landing", "trainer=smoke", *small, *overrides])
    with open_dict(cfg):
        cfg.task.name = "toy"
        cfg.task.components = list(ToyTask.REWARD_COMPONENTS)
        cfg.task.weights = dict.fromkeys(ToyTask.REWARD_COMPONENTS, 1.0)
        cfg.task.env = {"_target_": "tests.toy.ToyTask"}
    return cfg


# The toy world is installed like anyone's package, for this process and those it starts.
INSTALLED = str(Path(__file__).parent / "installed")
ROOT = str(Path(__file__).parents[1])
sys.path.append(INSTALLED)
os.environ["PYTHONPATH"] = os.pathsep.join(
    [ROOT, INSTALLED, *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
).strip(os.pathsep)

# Seconds that each file's tests take, together: the longest begin first, so that no processor waits long for its
# neighbour at the end. Measured anew with --record-durations.
DURATIONS = Path(__file__).with_name("durations.json")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record-durations", action="store_true", help=f"write what each file takes to {DURATIONS.name}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    seconds = json.loads(DURATIONS.read_text())
    items.sort(key=lambda item: -seconds.get(item.nodeid.split("::")[0], 0))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if not config.getoption("--record-durations"):
        return
    seconds: dict[str, float] = {}
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                file = report.nodeid.split("::")[0]
                seconds[file] = seconds.get(file, 0) + report.duration
    ordered = sorted(seconds.items(), key=lambda entry: -entry[1])
    DURATIONS.write_text(json.dumps({file: round(taken, 1) for file, taken in ordered}, indent=1) + "\n")


# A busy machine is no failure.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


@pytest.fixture
def toy_config() -> Callable[..., DictConfig]:
    """See :func:`toy_settings`."""
    return toy_settings


@pytest.fixture
def run_directory(tmp_path: Path) -> Path:
    return tmp_path / "run"
