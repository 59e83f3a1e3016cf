"""Free text on the command line: it means itself, and what is printed can be pasted."""

from __future__ import annotations

import importlib
import shlex
import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf

from xqmap.config import arguments, cli
from xqmap.errors import UserError

# The name of the module is that of a function of the package.
train = importlib.import_module("xqmap.train")

_PARSER = OverridesParser.create()
_SIGNS = st.text(st.sampled_from("\\${}'\"a =:,.()[]\n?#;|&<>*~!é"), max_size=12)
_TEXT = st.one_of(
    _SIGNS, _SIGNS.map(lambda text: f"'{text}'"), st.text(max_size=20), st.sampled_from(["null", "7", "1e3"])
)


def read(argument: str) -> str:
    """What a command gets of an argument, after Hydra and OmegaConf."""
    override = _PARSER.parse_override(arguments.literal([argument])[0])
    return OmegaConf.create({"value": override.value()})["value"]


@given(_TEXT.filter(lambda text: text != "???"))
def test_what_is_printed_gives_the_same_text_back_when_it_is_pasted(text: str) -> None:
    [pasted] = shlex.split(arguments.setting("question", text))
    assert read(pasted) == text
    assert shlex.split(arguments.command("chat", question=text)) == ["python", "-m", "xqmap.chat", pasted]


@given(_TEXT.filter(lambda text: text.lower() not in ("null", "???") and text[:1] not in ("'", '"')))
def test_free_text_means_itself(text: str) -> None:
    assert read(f"question={text}") == text
    assert read(f"+question={text}") == text


@pytest.mark.parametrize(
    "question",
    [
        "Why didn't you take the red one?",
        "What if color counted 0.5 times (or 1,5 times) as much?",
        "is shape = 1 here, or {0}?",
        'What does "Q" mean?',
        "Warum nicht der grüne Würfel?",
        "${oc.env:HOME}?",
        " ",
        "1_000",
        "key=value",
        "C:\\maps\\",
    ],
)
def test_a_question_is_ordinary_english(question: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert given_to("chat", monkeypatch, f"question={question}").question == question


@pytest.mark.parametrize(
    "place",
    [
        "a b",
        "a=b",
        "a (1)",
        "+sweep=blocks,evaluation.seeds=[0,1]",
        "it's",
        '"quoted"',
        "ü",
        "${x}",
        "a\\b",
        "7",
        "nan",
        "-x",
        "#1",
    ],
)
def test_places_are_any_path(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(place).mkdir()
    cfg = given_to("chat", monkeypatch, f"run={place}", f"decision={place}/decision (1).json", f"out={place}")
    assert (cfg.run, cfg.decision, cfg.out) == (place, f"{place}/decision (1).json", place)


def test_hydras_own_ways_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = given_to("chat", monkeypatch, "run=null", "question='it is'", 'out="a b"', "++scene_seed=3", "steps=all")
    assert (cfg.run, cfg.question, cfg.out, cfg.scene_seed, cfg.steps) == (None, "it is", "a b", 3, "all")
    assert arguments.literal(["-m", "run=a,b", "run=a b", "trainer=smoke"]) == [
        "-m",
        "run=a,b",
        "run='a b'",
        "trainer=smoke",
    ]
    [directory] = arguments.literal(["hydra.run.dir=runs/${seed} (1)"])
    override = _PARSER.parse_override(directory)
    assert OmegaConf.create({"seed": 3, "dir": override.value()}).dir == "runs/3 (1)"


def test_three_question_marks_are_no_missing_value(monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = given_to("chat", monkeypatch, "question=???", "out=???")
    assert (cfg.question.strip(), Path(cfg.out)) == ("???", Path("???"))


@pytest.mark.parametrize("name", ["run", "out", "hydra.run.dir"])
def test_a_name_too_long_for_file_systems_is_told_with_its_setting(name: str) -> None:
    with pytest.raises(UserError, match=rf"^{name}: .* has 300 bytes.*shorter"):
        arguments.literal([f"{name}=a/{'é' * 150}/b"])
    assert arguments.literal([f"question={'a' * 300}"]) == [f"question='{'a' * 300}'"]


def test_a_name_too_long_that_the_product_made_is_told_too(tmp_path: Path) -> None:
    with pytest.raises(OSError) as caught:
        (tmp_path / ("a" * 300)).mkdir()
    assert "has 300 bytes" in cli.told(caught.value)
    assert "hydra.sweep.subdir" in cli.told(caught.value)


def test_the_command_that_goes_on_with_a_run_can_be_pasted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    run = tmp_path / "a=b (1)"
    (run / train.checkpoint.POLICY).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["train", "+task=landing", "hydra.run.dir=a=b (1)"])
    with pytest.raises(SystemExit, match="resume=") as stopped:
        train.main()
    *_, pasted = shlex.split(str(stopped.value.code).replace("error: ", ""))
    assert read(pasted) == str(run)


@pytest.mark.parametrize("given", [["++resume=run"], ["+resume=run", "++seed=77"], ["resume=run", "seed=77"]])
def test_resume_in_whatever_form_opens_no_other_directory(given: list[str]) -> None:
    arguments = ["train", *given]
    if len(given) > 1:
        with pytest.raises(SystemExit, match="no other setting"):
            cli.resume_in_place(arguments)
    else:
        cli.resume_in_place(arguments)
        assert "hydra.run.dir=." in arguments


def test_a_run_that_another_process_writes_is_not_read_to_go_on_from(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "run").mkdir()
    read: list[Path] = []
    monkeypatch.setattr(train.checkpoint, "read_training", read.append)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["train", "resume=run"])
    cli.resume_in_place(sys.argv)
    with train.locks.alone(tmp_path / "run"), pytest.raises(SystemExit, match="another process"):
        train.main()
    assert not read


def given_to(config: str, monkeypatch: pytest.MonkeyPatch, *given: str) -> DictConfig:
    """What a command with the settings of ``conf/<config>.yaml`` is called with."""
    called: list[DictConfig] = []
    monkeypatch.setattr(sys, "argv", [config, *given])
    cli.main(config)(called.append)()
    return called[0]
