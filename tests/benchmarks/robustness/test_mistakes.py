"""Every command and every kind of mistake: one line that names it, a status that is not 0, nothing written."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from xqmap.benchmarks.robustness.fuzz import DECISION
from xqmap.config import build
from xqmap.runs import checkpoint

COMMANDS = ("train", "evaluate", "explain", "chat", "film", "report", "doctor", "bench")


@pytest.fixture
def place(toy_config: Callable[..., DictConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current directory with a good decision, several bad ones, and a run of a world that is not to be trusted."""
    cfg = toy_config("qnet.width=2")
    cfg.task.env._target_ = "tests.toy.Stranger"
    facts = {"config": OmegaConf.to_container(cfg, resolve=True), "pixel_size": 0.1, "noise": {}, "frames": 0}
    checkpoint.write(tmp_path / "run" / checkpoint.POLICY, build.qmaps(cfg, 0.1).state_dict(), facts)
    good = json.dumps(DECISION)
    for name, content in {
        "good": good,
        "half": good[: len(good) // 2],
        "nan": good.replace("0.9", "NaN"),
        "huge": good.replace("0.9", "1e300"),
        "number": "7",
        "deep": "[" * 100_000,
        "empty": "",
    }.items():
        (tmp_path / f"{name}.json").write_text(content)
    (tmp_path / "binary.json").write_bytes(bytes(range(256)))
    (tmp_path / "bad.yaml").write_text("a: [1, 2\n  b: {")
    monkeypatch.chdir(tmp_path)
    return tmp_path


MISTAKES = [
    # unknown, malformed
    *((command, ["nonsense=1"], "nonsense") for command in COMMANDS),
    *(("explain", arguments, "") for arguments in (["=1"], ["what even"], ["+also={"], ["$'\x1b[2J'=1"])),
    # a run that is none, a file, or a stranger's
    *((command, [f"run={run}"], run) for command in ("explain", "chat", "film") for run in ("nowhere", "good.json")),
    *(("evaluate", [f"run={run}"], run) for run in ("good.json", "pretrained/nothing", "/proc/1/mem", "7")),
    ("evaluate", ["run='\x1b[2J'"], "[2J"),
    ("evaluate", ["run=[1,2]"], "run"),
    ("evaluate", ["run=run"], "tests.toy"),
    ("report", ["runs=[a,b]"], "runs"),
    ("explain", ["decision=7"], "7"),
    # a decision that is none
    *(
        ("explain", [f"decision={name}.json"], name)
        for name in ("half", "nan", "huge", "number", "deep", "empty", "binary")
    ),
    *((command, ["decision=."], ".") for command in ("explain", "chat")),
    # nowhere to write
    ("explain", ["decision=good.json", "out=/proc/nowhere"], "/proc/nowhere"),
    ("explain", ["decision=good.json", "out=good.json"], "good.json"),
    ("chat", ["decision=good.json", "question=why", "out=/proc/nowhere"], "/proc/nowhere"),
    # found out before the work, not after it
    ("evaluate", ["run=pretrained/landing", "out=/proc/nowhere/evaluation.json"], "/proc/nowhere"),
    ("evaluate", ["run=pretrained/landing", "out=."], "."),
    *((command, ["run=pretrained/landing", "out=/proc/nowhere"], "/proc/nowhere") for command in ("explain", "chat")),
    *((command, ["run=pretrained/landing", "decision=good.json"], "not both") for command in ("explain", "chat")),
    ("film", ["run=pretrained/landing", "out=good.json/film.mp4"], "good.json"),
    ("bench", ["what=soak", "out=/proc/nowhere/bench.json"], "/proc/nowhere"),
    ("report", ["runs=nowhere"], "nowhere"),
    ("report", ["runs=good.json"], "good.json"),
    ("train", ["+task=landing", "hydra.run.dir=good.json"], "good.json"),
    # wrong type, out of range, contradicting
    ("train", ["+task=landing", "trainer.learning_rate=nan"], "trainer.learning_rate"),
    ("train", ["+task=landing", "trainer.learning_rate=inf"], "trainer.learning_rate"),
    ("train", ["+task=landing", "trainer.decision_limit=0"], "trainer.decision_limit"),
    ("train", ["+task=landing", "task.weights.color=nan"], "task.weights"),
    ("train", ["+task=landing", "task.weights.color=red"], "task.weights.color"),
    ("train", ["+task=landing", "method.components=[]"], "method.components"),
    ("train", ["+task=landing", "method.weights=[1]"], "method.weights"),
    ("train", ["+task=landing", "qnet.plane_windows=[4]"], "qnet.plane_windows"),
    ("train", ["+task=landing", "evaluation.until={shape: 3}"], "evaluation.until"),
    ("train", ["+task=landing", "seed=1e99"], "seed"),
    ("train", ["+task=landing", "evaluation.seeds=[1,2,1]"], "evaluation.seeds names 1 twice"),
    ("train", ["+task=landing", f"qnet.plane_windows={[3] * 17}".replace(" ", "")], "qnet.plane_windows has 17"),
    ("train", ["+task=landing", f"seed={'9' * 5000}"], "digits"),
    ("train", ["+task=landing", "threads=0"], "threads"),
    ("train", ["+task=landing", "loss=nothing"], "loss/nothing"),
    ("train", ["resume=run"], "run"),
    ("train", ["resume=good.json"], "good.json"),
    ("train", ["resume=run/checkpoint/policy.safetensors"], "policy.safetensors holds no training"),
    ("chat", ["decision=good.json", "questions=nowhere.yaml"], "nowhere.yaml"),
    ("chat", ["decision=good.json", "questions=bad.yaml"], "bad.yaml"),
    ("chat", ["decision=good.json", "questions=number.json"], "number.json"),
    ("doctor", ["only=7"], "only"),
    ("bench", ["rounds=-1"], "rounds"),
    ("bench", ["settings=[loss.gamma=7]"], "loss.gamma"),
]


@pytest.mark.parametrize(("command", "arguments", "named"), MISTAKES, ids=lambda value: repr(value)[:60])
def test_a_mistake_is_one_line(
    command: str,
    arguments: list[str],
    named: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {path: path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()}
    monkeypatch.setattr(sys, "argv", [command, *arguments])
    module = importlib.import_module(f"xqmap.{command}")
    with pytest.raises(SystemExit) as stopped:
        if command == "train":
            module.cli.resume_in_place(sys.argv)
        module.main()
    told = str(stopped.value.code) if stopped.value.code != 2 else capsys.readouterr().err.strip().splitlines()[-1]
    assert stopped.value.code not in (0, None)
    assert len(told.splitlines()) == 1
    assert told.isprintable()
    assert named in told
    assert {path: path.stat().st_mtime_ns for path in place.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("command", "arguments"),
    [("train", ["+task=landing", "hydra.run.dir=made"]), ("explain", ["run=pretrained/landing"])],
)
def test_without_a_graphics_driver_the_fix_is_named(
    command: str, arguments: list[str], place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("VK_ICD_FILENAMES", "VK_DRIVER_FILES"):
        monkeypatch.setenv(name, str(place / "gone.json"))
    monkeypatch.setattr(sys, "argv", [command, *arguments])
    with pytest.raises(SystemExit, match=r"no device that can render.*make setup"):
        importlib.import_module(f"xqmap.{command}").main()
    assert not (place / "made").exists()
