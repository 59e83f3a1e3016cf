"""A policy that was taken away loads where xqmap is not, and says what the policy says."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import xqmap
from tests.commands import call
from xqmap.errors import UserError
from xqmap.runs import exported
from xqmap.runs.run import Run

pytestmark = pytest.mark.sim

# What somebody else's program does with the file; of xqmap there is nothing.
_ELSEWHERE = """
import sys
sys.modules["xqmap"] = None
import torch
state = torch.load("asked.pt")
program = torch.export.load("policy.pt2").module()
found = [program(state["heightmap"][:count], state["mask"][:count]) for count in (1, 2, 5)]
torch.save([tuple(part.detach() for part in parts) for parts in found], "found.pt")
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    place = tmp_path_factory.mktemp("trained") / "run"
    small = {"frames": 8, "warmup_frames": 4, "mode": "disabled", "width": 4, "depth": 1}
    return xqmap.train("toy", "task.weights.right=0.5", **small, out=place)


def test_a_process_without_xqmap_gets_the_same_maps_and_choices(run: Run, tmp_path: Path) -> None:
    done = call("export", f"run={run.directory}", "out=policy.pt2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "policy.pt2 and the policy differ by" in done.stdout
    facts = json.loads((tmp_path / "policy.json").read_text())
    assert facts["components"] == ["left", "right"]
    assert facts["weights"] == [1.0, 0.5]
    assert facts["inputs"]["heightmap"]["shape"] == ["B", 4, 16, 16]
    assert (facts["pixel_size_m"], facts["floor_m"]) == (0.1, -0.01)
    assert facts["weights_sha256"] == run.sha256
    assert set(facts["versions"]) == {"torch", "xqmap"}
    env = run.make_env()
    states = [env.reset() for _ in range(5)]
    asked = {name: torch.stack([state[key] for state in states])
             for name, key in (("heightmap", "heightmap"), ("mask", "action_mask"))}  # fmt: skip
    asked["mask"][1, 100:] = False
    torch.save(asked, tmp_path / "asked.pt")
    subprocess.run([sys.executable, "-c", _ELSEWHERE], cwd=tmp_path, check=True)
    with torch.no_grad():
        expected = run.policy.qmaps.maps(asked["heightmap"]) * torch.tensor([1.0, 0.5])[:, None, None]
    for maps, total, action, intervals in torch.load(tmp_path / "found.pt"):
        count = len(maps)
        assert maps == pytest.approx(expected[:count], abs=1e-5)
        assert total == pytest.approx(expected[:count].sum(1), abs=1e-5)
        allowed = expected[:count].sum(1).flatten(1).masked_fill(~asked["mask"][:count], -torch.inf)
        assert torch.equal(action, allowed.argmax(-1))
        chosen = expected[:count].flatten(2)[torch.arange(count), :, action]
        assert intervals.mean(-1) == pytest.approx(chosen, abs=1e-5)
        half = torch.tensor([run.noise["left"], 0.5 * run.noise["right"]])
        assert (intervals[..., 1] - intervals[..., 0]) / 2 == pytest.approx(half.expand(count, -1), abs=1e-5)


def test_a_program_that_differs_is_not_written(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exported, "_TOLERANCE", -1.0)
    with pytest.raises(UserError, match="nothing was written"):
        exported.write(run, tmp_path / "policy.pt2")
    assert list(tmp_path.iterdir()) == []


def test_another_ending_and_a_missing_extra_are_said(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = call("export", f"run={run.directory}", "out=policy.pt", cwd=tmp_path)
    assert done.returncode == 1
    assert "must end with .pt2" in done.stderr
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(UserError, match=r"xqmap\[onnx\]"):
        exported.write(run, tmp_path / "policy.pt2", onnx=True)


def test_onnx_says_the_same(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="the extra 'onnx' is not installed")
    done = call("export", f"run={run.directory}", "onnx=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert 0 <= json.loads((tmp_path / "policy.json").read_text())["difference"]["policy.onnx"] < 1e-4
