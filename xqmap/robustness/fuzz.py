"""Nonsense for every door: decision files, run directories, overrides. Each is taken or refused in one line; nothing else may happen."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hydra import compose
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from tqdm import tqdm

from xqmap import checkpoint, cli, schema
from xqmap.explanations import Decision

_HOSTILE = (
    "",
    "\x00",
    "\x1b[2J",
    "<script>alert(1)</script>",
    "${oc.env:HOME}",
    "${",
    "???",
    "../../etc/passwd",
    "ignore the above",
    "\u202e",
    "{0.__class__}",
    "%s%n",
    "é" * 300,
    "-0",
    "1e999",
    "nan",
)
# Of a training's settings, with some that are not.
_KEYS = [
    *("seed", "~seed", "device", "threads", "resume", "trainer", "trainer.frames", "trainer.precision", "trainer.frams", "loss"),
    *("loss.gamma", "task", "+task", "task.weights", "task.weights.color", "task.env", "task.env.altitude", "task.components", "method"),
    *("method.weights", "replay.capacity", "evaluation.seeds", "evaluation.until", "qnet.plane_windows", "collector", "logger.mode"),
    *("exploration.eps_init", "hydra.run.dir", "+new"),
]
_text = st.sampled_from(_HOSTILE) | st.text(max_size=20)
_scalar = st.none() | st.booleans() | st.integers() | st.floats() | _text | st.sampled_from([10**400, -1, 2**63, 1e308])
_value = st.recursive(_scalar, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_text, inner, max_size=4), max_leaves=8)

DECISION: dict[str, Any] = {
    "task": "landing",
    "scene_seed": 3,
    "step": 0,
    "components": ["flatness", "color"],
    "candidates": [
        {
            "label": "Selected",
            "object": "blue flat block",
            "pixel": [3, 4],
            "position": [0.0, 1.0, 2.0],
            "values": {"flatness": 1, "color": 0.9},
        },
        {"label": "A", "object": "ground", "pixel": [7, 4], "object_index": None, "values": {"flatness": 1.1, "color": 0}},
        {"label": "B", "object": "red block", "values": {"flatness": 0.1, "color": 1.0}},
    ],
    "objects": [{"object": "blue flat block", "object_index": 0, "pixel": [3, 4], "values": {"flatness": 1, "color": 0.9}}],
    "noise": {"flatness": 0.1, "color": 0.1},
}


@st.composite
def changed(draw: st.DrawFn, original: Any) -> Any:
    """``original`` with one to three places changed, removed or added."""
    content = copy.deepcopy(original)
    for _ in range(draw(st.integers(1, 3))):
        place = content
        while True:
            names = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not names:
                break
            name = draw(st.sampled_from(names))
            if isinstance(place[name], dict | list) and place[name] and draw(st.booleans()):
                place = place[name]
                continue
            if draw(st.booleans()):
                place[name] = draw(_value)
            elif isinstance(place, dict):
                del place[name]
                place[draw(_text)] = draw(_value)
            else:
                place.insert(name, draw(_value))
            break
    return content


def _refused(act: Callable[[], Any]) -> bool:
    """Whether ``act`` is refused in one line; False if it does what was asked.

    Raises:
        Exception: whatever else ``act`` does: a bug.
    """
    try:
        act()
    except Exception as error:
        if not (line := cli.told(error)) or len(cli.one_line(line).splitlines()) != 1:
            raise
        return True
    return False


def _run(strategy: st.SearchStrategy[Any], check: Callable[[Any], bool], cases: int, name: str) -> dict[str, int]:
    count = {"cases": 0, "refused": 0}

    with tqdm(total=cases, unit="case", desc=name, mininterval=1.0) as bar:

        @seed(0)
        @settings(max_examples=cases, deadline=None, database=None, suppress_health_check=list(HealthCheck), phases=[Phase.generate])
        @given(strategy)
        def each(case: Any) -> None:
            count["cases"] += 1
            count["refused"] += check(case)
            bar.update()

        each()
    return count


def decisions(folder: Path, cases: int) -> dict[str, int]:
    """Decision files: a good one changed, any JSON, any bytes. One that is taken must come out as JSON again."""
    path = folder / "decision.json"
    strategy = (
        changed(DECISION).map(lambda content: json.dumps(content).encode("utf-8", "surrogatepass"))
        | _value.map(lambda content: json.dumps(content).encode("utf-8", "surrogatepass"))
        | st.binary(max_size=200)
    )

    def check(content: bytes) -> bool:
        path.write_bytes(content)
        return _refused(lambda: json.dumps(Decision.load(path).to_dict(), allow_nan=False))

    return _run(strategy, check, cases, "decision files")


def run_directories(file: Path, folder: Path, cases: int) -> dict[str, int]:
    """Run directories around a good policy ``file``: its facts changed and signed again, its bytes changed, tensors renamed."""
    tensors, facts = checkpoint.read(file)
    whole = file.read_bytes()
    target = folder / checkpoint.POLICY
    bytewise = st.tuples(st.integers(0, len(whole) - 1), st.binary(max_size=4)).map(
        lambda c: whole[: c[0]] + c[1] + whole[c[0] + len(c[1]) :]
    )
    strategy = changed(facts) | bytewise | st.sampled_from(sorted(tensors))

    def check(case: Any) -> bool:
        if isinstance(case, bytes):
            checkpoint.write_atomically(target, case)
        elif isinstance(case, str):
            checkpoint.write(target, {name: value for name, value in tensors.items() if name != case}, facts)
        else:
            checkpoint.write(target, tensors, case)
        return _refused(lambda: checkpoint.load_run(folder))

    return _run(strategy, check, cases, "run directories")


def overrides(cases: int) -> dict[str, int]:
    """``key=value`` arguments of a training: known and unknown keys with any value, and any text."""
    names = st.sampled_from(_KEYS)
    # json.dumps refuses nothing that Python holds, so these are also Hydra's lists and dictionaries.
    value = _text | _value.map(lambda content: json.dumps(content)[:200])
    strategy = st.lists(st.tuples(names, st.sampled_from(["=", "", "=="]), value).map("".join) | _text, min_size=1, max_size=3)
    schema.register()

    def check(arguments: list[str]) -> bool:
        try:
            cfg = compose("config", ["+task=landing", *arguments])
        except Exception as error:
            return bool(cli.mistake(error))
        return _refused(lambda: schema.validate(cfg))

    return _run(strategy, check, cases, "overrides")
