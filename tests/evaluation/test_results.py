"""The table: who is pooled with whom, and what stands beside it."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest

from xqmap.errors import UserError
from xqmap.evaluation import results, tables
from xqmap.evaluation.statistics import wilson
from xqmap.evaluation.swept import swept


def write_run(
    root: Path,
    name: str,
    correct: int,
    choices: int = 10,
    *,
    task: str = "landing",
    method: str = "xqmap",
    seed: int = 0,
    **settings: Any,
) -> Path:
    """A finished run as training leaves it, as far as the table needs it."""
    folder = root / name
    (folder / ".hydra").mkdir(parents=True)
    lines = [f"seed: {seed}", *(f"{key}: {json.dumps(value)}" for key, value in settings.items())]
    (folder / ".hydra" / "config.yaml").write_text("\n".join(lines))
    runs = [
        {
            "seed": i,
            "choices": 1,
            "correct": int(i < correct),
            "regret": float(i >= correct),
            "components": {"color": 1.0},
        }
        for i in range(choices)
    ]
    baselines = {
        "random pixel": {"mean": 0.1, "std": 0.3, "choices": choices, "ci95": list(wilson(1, 10)), "regret": 0.9}
    }
    content = {
        "task": task,
        "method": method,
        "training_seed": seed,
        "runs": runs,
        "baselines": baselines,
        "weights_sha256": name,
    }
    (folder / "evaluation.json").write_text(json.dumps(content | {"confusion": {"cube": {"bowl": 1}}}))
    return folder


def test_one_policy_has_wilsons_interval(tmp_path: Path) -> None:
    write_run(tmp_path, "a", 9)
    row, baseline = results.table(results.collect(tmp_path)[0], {"landing": {"xqmap": "90 ± 0.09 %"}})
    assert (row.mean, row.choices, row.interval, row.paper) == (pytest.approx(0.9), 10, "Wilson", "90 ± 0.09 %")
    assert row.ci95 == pytest.approx(wilson(9, 10))
    assert row.regret == pytest.approx(0.1)
    assert (baseline.name, baseline.mean, baseline.training_seeds) == ("random pixel", 0.1, [])


def test_trainings_that_differ_in_their_seed_are_one_row(tmp_path: Path) -> None:
    for seed, correct in enumerate([10, 8, 2]):
        write_run(tmp_path, f"s{seed}", correct, seed=seed, device="cpu" if seed else "auto")
    row, baseline = results.table(results.collect(tmp_path)[0])
    assert row.training_seeds == [0, 1, 2]
    assert row.mean == pytest.approx(20 / 30)
    assert row.interval == "bootstrap"
    # Between the worst and the best training, and wider than if 30 choices of one policy had been right 20 times.
    assert row.ci95 == pytest.approx((0.2, 1.0))
    assert row.confusion == {"cube": {"bowl": 3}}
    assert baseline.choices == 10


def test_flawless_trainings_are_still_uncertain(tmp_path: Path) -> None:
    for seed in range(3):
        write_run(tmp_path, f"s{seed}", 10, seed=seed)
    row = results.table(results.collect(tmp_path)[0])[0]
    assert row.ci95 == pytest.approx(wilson(30, 30))


def test_swept_settings_split_rows_and_are_named(tmp_path: Path) -> None:
    for width in (8, 16):
        for seed in (0, 1):
            write_run(tmp_path, f"w{width}s{seed}", 9, seed=seed, qnet={"width": width, "depth": 2})
    found, _ = results.collect(tmp_path)
    assert swept(found) == {"landing": ["qnet.width"]}
    assert [row.label for row in results.table(found)] == [
        "xqmap, qnet.width=8",
        "xqmap, qnet.width=16",
        "random pixel",
    ]


def test_settings_that_change_together_are_named_by_one(tmp_path: Path) -> None:
    for name, frames, batch, gamma in [("a", 40, 8, 0), ("b", 1000, 32, 0), ("c", 1000, 32, 0.5)]:
        write_run(tmp_path, name, 9, trainer={"frames": frames, "batch": batch}, loss={"gamma": gamma})
    assert swept(results.collect(tmp_path)[0]) == {"landing": ["trainer.frames", "loss.gamma"]}


def test_a_setting_that_older_trainings_lack_was_not_swept(tmp_path: Path) -> None:
    write_run(tmp_path, "old", 9, qnet={"width": 8})
    write_run(tmp_path, "new", 9, seed=1, qnet={"width": 8, "depth": 2})
    assert [row.label for row in results.table(results.collect(tmp_path)[0])] == ["xqmap", "random pixel"]


def test_columns_that_no_row_fills_are_left_out(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "a", 9)
    assert tables.lines(results.table(results.collect(tmp_path)[0]))[0][:3] == ["task", "method", "best choices"]
    (folder / "evaluation-hard.json").write_text((folder / "evaluation.json").read_text())
    head, *every = tables.lines(results.table(results.collect(tmp_path)[0], {"landing": {"xqmap": "90 %"}}))
    assert (head[1], head[-1]) == ("sheet", "paper")
    assert [line[1] for line in every] == ["", "", "hard", "hard"]


def test_tasks_methods_and_sheets_stay_apart(tmp_path: Path) -> None:
    write_run(tmp_path, "a", 9)
    write_run(tmp_path, "b", 8, method="qlearning")
    write_run(tmp_path, "c", 7, task="grasping", gamma=0.5)
    assert results.paper_figures()["grasping"]["xqmap"].startswith("90.93")
    (tmp_path / "a" / "evaluation-hard.json").write_text((tmp_path / "a" / "evaluation.json").read_text())
    rows = [
        row for row in results.table(results.collect(tmp_path)[0], {"landing": {"xqmap": "90 %"}}) if row.training_seeds
    ]
    assert [(row.task, row.sheet, row.label, row.paper) for row in rows] == [
        ("grasping", "", "xqmap", ""),
        ("landing", "", "xqmap", "90 %"),
        ("landing", "", "qlearning", ""),
        ("landing", "hard", "xqmap", ""),
    ]


def test_a_copied_run_counts_once_and_what_is_broken_is_told(tmp_path: Path) -> None:
    folder = write_run(tmp_path, "a", 9)
    (tmp_path / "copy").mkdir()
    (tmp_path / "copy" / "evaluation.json").write_text((folder / "evaluation.json").read_text())
    odd = json.dumps(json.loads((folder / "evaluation.json").read_text()) | {"confusion": [1]})
    for name, text in {
        "half": '{"task": "lan',
        "foreign": '{"accuracy": 1}',
        "none": json.dumps([1]),
        "odd": odd,
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "evaluation.json").write_text(text)
    found, unread = results.collect(tmp_path)
    assert len(found) == 1
    assert {path.parent.name for path in unread} == {"half", "foreign", "none", "odd"}
    with pytest.raises(UserError, match="no directory"):
        results.collect(tmp_path / "nowhere")


def test_every_form_holds_the_same_numbers(tmp_path: Path) -> None:
    write_run(tmp_path, "a", 9)
    rows = results.table(results.collect(tmp_path)[0])
    entry = next(csv.DictReader(io.StringIO(tables.comma_separated(rows))))
    assert float(entry["mean"]) == pytest.approx(0.9)
    assert float(entry["ci95_low"]) == pytest.approx(wilson(9, 10)[0])
    for form in (tables.text, tables.markdown):
        assert "90.0 %" in form(rows)
        assert "59.6 – 98.2 %" in form(rows)
