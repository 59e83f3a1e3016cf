"""The commands as a person calls them: mistakes give one clear line, a non-zero exit, and leave nothing behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.commands import call, start
from xqmap.config import plugins

MISTAKES = [
    ("train", [], "+task=landing"),
    ("train", ["+task=flying"], "task/flying"),
    ("train", ["+task=landing", "trainer.frames=-5"], "trainer.frames"),
    ("train", ["+task=landing", "loss.gamma=abc"], "loss.gamma"),
    ("train", ["+task=landing", "loss.gamma=1.5"], "loss.gamma"),
    ("train", ["+task=landing", "trainer.frams=5"], "frams"),
    ("train", ["+task=landing", "task.weights.shape=2"], "task.weights.shape"),
    ("train", ["+task=landing", "evaluation.seeds=[]"], "evaluation.seeds"),
    ("train", ["+task=landing", "hydra.run.dir=/proc/nowhere"], "/proc/nowhere"),
    ("train", ["resume=nowhere"], "nowhere"),
    ("train", ["resume=nowhere", "seed=3"], "resume"),
    ("evaluate", [], "run"),
    ("evaluate", ["run=nowhere"], "nowhere"),
    ("train", ["+task=landing", "task.env.altitude=-3"], "altitude"),
    ("explain", [], "run=DIR"),
    ("explain", ["decision=nowhere.json"], "nowhere.json"),
    ("explain", ["run=a", "decision=b"], "not both"),
    ("explain", ["run=nowhere", "scene_seed=-1"], "scene_seed"),
    ("explain", ["run=nowhere", "steps=some"], "steps"),
    ("explain", ["run=nowhere", "scene_seed=x"], "scene_seed"),
    ("chat", ["decision=nowhere.json", "question=why"], "nowhere.json"),
    ("chat", ["decision=nowhere.json", "llm=parrot"], "llm/parrot"),
    ("doctor", ["only=teeth"], "teeth"),
    ("bench", ["what=everything"], "what=everything"),
    ("bench", ["task_name=flying", "what=env"], "task/flying"),
]


@pytest.mark.parametrize(("module", "arguments", "named"), MISTAKES, ids=lambda value: str(value))
def test_mistakes(module: str, arguments: list[str], named: str, tmp_path: Path) -> None:
    done = call(module, *arguments, cwd=tmp_path)
    assert done.returncode != 0
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("error: ")
    assert named in lines[0]
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_mistake_is_one_line_of_a_new_interpreter_too(tmp_path: Path) -> None:
    done = start("train", "+task=landing", "trainer.frams=5", cwd=tmp_path)
    assert done.returncode != 0
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith("error: ")


def decision_file(folder: Path) -> Path:
    values = {"Selected": [0.9, 1.0], "A": [1.0, 0.0], "B": [0.1, 1.1]}
    things = {"Selected": "blue flat block", "A": "ground", "B": "red inclined block"}
    content = {
        "task": "landing",
        "components": ["flatness", "color"],
        "candidates": [
            {"label": name, "object": things[name], "values": {"flatness": v[0], "color": v[1]}}
            for name, v in values.items()
        ],
    }
    path = folder / "decision.json"
    path.write_text(json.dumps(content))
    return path


def test_a_decision_file_is_explained(tmp_path: Path) -> None:
    done = start("explain", f"decision={decision_file(tmp_path)}", "out=seen", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    written = {path.name for path in (tmp_path / "seen").iterdir()}
    assert {"decision.json", "values.png", "rdx.png", "values.svg", "explanation.txt", "explanation.html"} <= written
    assert "wrote" in done.stdout
    assert "qmaps are not drawn" in done.stdout
    assert "overview.png" in written


def test_a_decision_file_is_talked_about(tmp_path: Path) -> None:
    path = decision_file(tmp_path)
    done = call("chat", f"decision={path}", 'question="Why not A?"', "show_prompt=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "color speaks for it (+1.00)" in done.stdout
    assert "Q_flatness=0.90" in done.stdout
    assert (tmp_path / "explanation" / "dialogue.json").exists()
    questions = plugins.CONF / "explain" / "questions" / "landing.yaml"
    done = call("chat", f"decision={path}", f"questions={questions}", cwd=tmp_path)
    assert "100.0% of the answers grounded, 100.0% as expected" in done.stdout
    bad = call("chat", f"decision={path}", "llm=openai", "question=why", cwd=tmp_path)
    assert bad.returncode != 0
    assert "OPENAI_API_KEY" in bad.stderr


def test_nothing_is_written_beside_a_decision_that_may_be_a_strangers(tmp_path: Path) -> None:
    theirs, here = tmp_path / "theirs", tmp_path / "here"
    theirs.mkdir()
    here.mkdir()
    path = decision_file(theirs)
    for command, more in (("explain", []), ("chat", ["question=why"])):
        done = call(command, f"decision={path}", *more, cwd=here)
        assert done.returncode == 0, done.stderr
    assert [entry.name for entry in theirs.iterdir()] == ["decision.json"]
    assert {"explanation.txt", "dialogue.json"} <= {entry.name for entry in (here / "explanation").iterdir()}


def test_doctor_finds_this_machine_fit(tmp_path: Path) -> None:
    done = call("doctor", cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert "ok  vulkan" in done.stdout
