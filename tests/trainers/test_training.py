"""The whole way in the toy world: training, interrupting, going on, loading, evaluating."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig
from torchrl.envs.utils import check_env_specs

from xqmap.config import build
from xqmap.errors import UserError
from xqmap.evaluation import baselines, play
from xqmap.evaluation.run import evaluate_run
from xqmap.runs import checkpoint
from xqmap.runs.places import home
from xqmap.runs.run import load_run
from xqmap.trainers.callbacks import make_trainer
from xqmap.trainers.trainer import Trainer

pytestmark = pytest.mark.sim


def train(cfg: DictConfig, directory: Path, resume: bool = False) -> Trainer:
    directory.mkdir(exist_ok=True)
    trainer = make_trainer(cfg, directory, checkpoint.read_training(directory) if resume else None)
    trainer.run()
    trainer.close()
    return trainer


def test_environment_keeps_its_specs(toy_config: Callable[..., DictConfig]) -> None:
    env = build.make_env(toy_config(), 3)()
    check_env_specs(env)
    state = env.reset()
    assert (env.scene_seed, state["heightmap"].shape) == (env.next_scene - 1, (4, 16, 16))
    point = env.point(16 * 2 + 3)
    assert env.action_at(point) == 16 * 2 + 3


@pytest.mark.parametrize("method", ["xqmap", "qlearning", "hra"])
def test_every_method_trains_evaluates_and_leaves_what_it_should(
    toy_config: Callable[..., DictConfig], run_directory: Path, method: str
) -> None:
    cfg = toy_config(f"method={method}")
    train(cfg, run_directory)
    result = evaluate_run(run_directory, cfg.evaluation, run_directory / "evaluation.json")
    assert json.loads((run_directory / "evaluation.json").read_text()) == result
    made = {"runs", "success", "optimal", "confusion", "baselines", "world_sha256"}
    assert {
        "task",
        "method",
        "training_seed",
        "settings",
        "decisions",
        "weights_sha256",
        "machine",
        "versions",
    } | made == set(result)
    assert (
        sum(count for bests in result["confusion"].values() for count in bests.values()) == result["success"]["choices"]
    )
    # The toy world has a future, and is solved.
    solved = {"asked", "optimal", "return", "optimum"}
    assert set(result["runs"][0]) == {"seed", "choices", "correct", "regret", "components"} | solved
    assert result["baselines"]["oracle"]["mean"] == 1.0
    assert {"threads", "device", "training_precision", "simulation", "rendering"} <= set(result["machine"])
    assert result["decisions"] == cfg.trainer.frames
    with open(run_directory / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["frames"]) == cfg.trainer.frames
    assert all(f"return/{name}" in rows[0] for name in ("left", "right"))
    assert float(rows[-1]["updates"]) > 0


@pytest.mark.parametrize("choice_period", [1, 50])
def test_an_agent_of_the_toy_world_finds_the_best_patch(
    toy_config: Callable[..., DictConfig], run_directory: Path, choice_period: int
) -> None:
    budget = ["trainer.frames=240", "trainer.updates_per_frame=1", "trainer.batch_size=16"]
    cfg = toy_config(*budget, "exploration.annealing_frames=160", f"trainer.choice_period={choice_period}")
    train(cfg, run_directory)
    run = load_run(run_directory)
    env = build.make_env(cfg, 0)()
    played = play.play(baselines.greedy(run.policy), env, seed=0, choices=20, until=None)
    assert played["correct"] >= 18


def test_confusion_counts_the_object_chosen_against_the_best(toy_config: Callable[..., DictConfig]) -> None:
    env = build.make_env(toy_config(), 0)()

    def always_green_then_table(state, env, generator):  # type: ignore[no-untyped-def]
        return 16 * 3 + 11 if env.task.made == 0 else 0

    seen: Counter[tuple[str, str]] = Counter()
    play.play(always_green_then_table, env, seed=0, choices=2, until=None, confusion=seen)
    assert seen == {("green patch", "red patch"): 1, ("table", "red patch"): 1}
    seen.clear()
    play.play(baselines.oracle, env, seed=0, choices=2, until=None, confusion=seen)
    assert seen == {("red patch", "red patch"): 1, ("green patch", "green patch"): 1}


def test_a_preference_changes_what_is_learned_and_what_counts_as_best(
    toy_config: Callable[..., DictConfig], run_directory: Path
) -> None:
    budget = [
        "trainer.frames=240",
        "trainer.updates_per_frame=1",
        "trainer.batch_size=16",
        "exploration.annealing_frames=160",
    ]
    cfg = toy_config(*budget, "loss.gamma=0")
    # Green is worth 0.2 + 4 · 0.6, blue 4 · 0.4, red only 1; without the preference red is best.
    cfg.task.weights.right = 4.0
    train(cfg, run_directory)
    run = load_run(run_directory)
    env = build.make_env(cfg, 0)()
    seen: Counter[tuple[str, str]] = Counter()
    played = play.play(baselines.greedy(run.policy), env, seed=0, choices=20, until=None, confusion=seen)
    assert played["correct"] >= 18
    assert seen["green patch", "green patch"] >= 9
    assert seen["red patch", "red patch"] == 0
    # What is learned are the properties themselves, not yet weighed.
    env.next_scene = 0
    out = run.policy(env.reset().select("heightmap", "action_mask"))
    assert float(out["chosen_component_value"][0].detach()) < 1.5


@pytest.mark.parametrize(("replay", "choice_period"), [("uniform", 1), ("prioritized", 1), ("uniform", 7)])
def test_a_run_that_was_interrupted_ends_like_one_that_was_not(
    toy_config: Callable[..., DictConfig], tmp_path: Path, replay: str, choice_period: int
) -> None:
    # Three decisions a batch and two an episode: most checkpoints lie in the middle of an episode.
    settings = [
        "trainer.frames=48",
        "trainer.checkpoint_period=9",
        "replay.capacity=30",
        "collector.frames_per_batch=3",
    ]
    cfg = toy_config(f"replay={replay}", f"trainer.choice_period={choice_period}", *settings)
    train(cfg, tmp_path / "whole")

    (tmp_path / "part").mkdir()
    part = make_trainer(cfg, tmp_path / "part")
    step = part._step

    def interrupted(batch):  # type: ignore[no-untyped-def]
        row = step(batch)
        if part.frames >= 36:
            raise KeyboardInterrupt
        return row

    part._step = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        part.run()
    resumed = train(cfg, tmp_path / "part", resume=True)
    assert resumed.frames == 48
    shas = [load_run(tmp_path / name).sha256 for name in ("whole", "part")]
    assert shas[0] == shas[1]
    assert rows(tmp_path / "part") == rows(tmp_path / "whole")
    assert [path.name for path in checkpoint.trainings(tmp_path / "part")] == [
        "training-000048.safetensors",
        "training-000039.safetensors",
    ]


def test_a_run_goes_on_with_the_threads_it_had(toy_config: Callable[..., DictConfig], run_directory: Path) -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        train(toy_config(), run_directory)
        torch.set_num_threads(1)
        train(toy_config(), run_directory, resume=True)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def rows(directory: Path) -> list[dict[str, str]]:
    """The metrics but for wall-clock."""
    with open(directory / "metrics.csv", newline="") as file:
        return [
            {name: row[name] for name in row if not name.startswith(("seconds", "share/"))}
            for row in csv.DictReader(file)
        ]


def test_same_seed_same_weights_and_other_seed_others(toy_config: Callable[..., DictConfig], tmp_path: Path) -> None:
    shas = []
    for name, seed in [("a", 0), ("b", 0), ("c", 1)]:
        train(toy_config(f"seed={seed}"), tmp_path / name)
        shas.append(load_run(tmp_path / name).sha256)
    assert shas[0] == shas[1] != shas[2]


def test_damaged_foreign_and_missing_checkpoints_are_refused_by_name(
    toy_config: Callable[..., DictConfig], run_directory: Path
) -> None:
    with pytest.raises(UserError, match="there is no"):
        load_run(run_directory)
    train(toy_config(), run_directory)
    path = run_directory / checkpoint.POLICY
    whole = path.read_bytes()
    for name, content in {
        "truncated": whole[: len(whole) // 2],
        "flipped": whole[:-5] + bytes([whole[-5] ^ 255]) + whole[-4:],
        "foreign": b"not a checkpoint",
    }.items():
        path.write_bytes(content)
        with pytest.raises(UserError, match=r"damaged|not written"):
            load_run(run_directory)
        assert name
    path.write_bytes(whole)
    load_run(run_directory)


def test_a_strangers_settings_cannot_name_code(
    toy_config: Callable[..., DictConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    cfg = toy_config()
    cfg.task.env = {"_target_": "tests.toy.ToyTask", "first": {"_target_": "os.system", "command": "true"}}
    with pytest.raises(UserError, match=r"os\.system"):
        build.task(cfg)


def test_evaluation_and_training_never_share_a_scene() -> None:
    last = 9999 + play.SCENES_APART * 1000
    assert last < play.training_scenes(0)
    assert play.training_scenes(0) + play.SCENES_PER_TRAINING <= play.training_scenes(1)
    assert play.training_scenes(3000) + play.SCENES_PER_TRAINING < 2**32


def test_runs_end_by_choices_or_by_a_sum(toy_config: Callable[..., DictConfig]) -> None:
    env = build.make_env(toy_config(), 0)()
    assert play.play(baselines.oracle, env, 0, 7, None)["choices"] == 7
    ended = play.play(baselines.oracle, env, 0, 50, {"left": 3.0})
    assert ended["choices"] < 10
    assert ended["components"]["left"] * ended["choices"] >= 3.0


def test_nan_in_the_loss_stops_with_one_line(toy_config: Callable[..., DictConfig], run_directory: Path) -> None:
    run_directory.mkdir()
    trainer = make_trainer(toy_config(), run_directory)
    with torch.no_grad():
        trainer.loss.value_network_params.apply(lambda p: p.data.fill_(float("nan")))
    with pytest.raises(UserError, match=r"trainer\.learning_rate"):
        trainer.run()


def test_an_agent_of_before_a_training_setting_was_there_still_plays(
    toy_config: Callable[..., DictConfig], run_directory: Path
) -> None:
    train(toy_config(), run_directory)
    tensors, facts = checkpoint.read(run_directory / checkpoint.POLICY)
    del facts["config"]["replay"]["capacity"]
    checkpoint.write(run_directory / checkpoint.POLICY, tensors, facts)
    assert load_run(run_directory).policy.qmaps.components == ("left", "right")
    del facts["config"]["qnet"]["width"]
    checkpoint.write(run_directory / checkpoint.POLICY, tensors, facts)
    with pytest.raises(UserError, match=r"qnet\.width"):
        load_run(run_directory)


def test_an_agent_that_ships_is_found_by_name_and_nothing_is_written_beside_it(
    toy_config: Callable[..., DictConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("xqmap.runs.places.PRETRAINED", tmp_path / "package" / "pretrained")
    train(toy_config(), tmp_path / "run")
    place = tmp_path / "package" / "pretrained" / "toy" / checkpoint.POLICY
    place.parent.mkdir(parents=True)
    place.write_bytes((tmp_path / "run" / checkpoint.POLICY).read_bytes())
    monkeypatch.chdir(tmp_path)
    run = load_run("pretrained/toy")
    assert run.sha256 == load_run(tmp_path / "run").sha256
    assert run.directory == home("pretrained/toy") == Path()
    assert home("run") == Path("run")
    with pytest.raises(UserError, match="toy do, make pretrained"):
        load_run("pretrained/flying")
