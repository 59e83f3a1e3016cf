"""Nonsense for every door: decision files, run directories, overrides. Each is taken or refused in one line; nothing
else may happen.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hydra import compose
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from xqmap import report
from xqmap.benchmarks.robustness.samples import ASKED, DECISION, EVALUATION, HOSTILE, KEYS, METRICS, SETTINGS
from xqmap.config import cli, plugins, schema
from xqmap.explanations import Decision
from xqmap.explanations.dialogue.conversation import Dialogue
from xqmap.explanations.views.page import page
from xqmap.explanations.views.sentences import why, wording_for
from xqmap.files import write_atomically
from xqmap.runs import checkpoint
from xqmap.runs.run import load_run
from xqmap.terminal import one_line

_text = st.sampled_from(HOSTILE) | st.text(max_size=20)
_scalar = st.none() | st.booleans() | st.integers() | st.floats() | _text | st.sampled_from([10**400, -1, 2**63, 1e308])
_value = st.recursive(
    _scalar, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(_text, inner, max_size=4), max_leaves=8
)

# One accepted file in so many is drawn, too, which takes as long as reading hundreds.
_DRAWN = 100


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
        if not (line := cli.told(error)) or len(one_line(line).splitlines()) != 1:
            raise
        return True
    return False


def _run(strategy: st.SearchStrategy[Any], check: Callable[[Any], bool], cases: int, name: str) -> dict[str, int]:
    """Counts ``cases``, how many of them are ``refused`` and how many end in a ``crash``, each of which is printed."""
    count = {"cases": 0, "refused": 0, "crashes": 0}

    with tqdm(total=cases, unit="case", desc=name, mininterval=1.0) as bar:

        @seed(0)
        @settings(
            max_examples=cases,
            deadline=None,
            database=None,
            suppress_health_check=list(HealthCheck),
            phases=[Phase.generate],
        )
        @given(strategy)
        def each(case: Any) -> None:
            count["cases"] += 1
            try:
                count["refused"] += check(case)
            except Exception as error:
                count["crashes"] += 1
                bar.write(one_line(f"{name}: {type(error).__name__}: {error!s:.200} from {case!r:.500}"))
            bar.update()

        each()
    return count


def _bytes(content: st.SearchStrategy[Any]) -> st.SearchStrategy[bytes]:
    return content.map(lambda value: json.dumps(value).encode("utf-8", "surrogatepass"))


def decisions(folder: Path, cases: int) -> dict[str, int]:
    """Decision files: a good one changed, any JSON, any bytes. One that is taken must be explained, answer questions
    and be JSON again.
    """
    path, taken = folder / "decision.json", 0

    def explained() -> None:
        nonlocal taken
        decision = Decision.load(path)
        json.dumps(decision.to_dict(), allow_nan=False)
        why(decision)
        dialogue = Dialogue(decision, wording_for(decision.task))
        for question in ASKED:
            dialogue.ask(question)
        (dialogue.to_json() + dialogue.to_markdown()).encode()
        if taken % _DRAWN == 0:
            page([decision], [(e.question, e.answer) for e in dialogue.exchanges]).encode()
        taken += 1

    def check(content: bytes) -> bool:
        path.write_bytes(content)
        return _refused(explained)

    return _run(_bytes(changed(DECISION)) | _bytes(_value) | st.binary(max_size=200), check, cases, "decision files")


def run_directories(file: Path, folder: Path, cases: int) -> dict[str, int]:
    """Run directories around a good policy ``file``: its facts changed and signed again, its bytes changed, tensors
    renamed.
    """
    tensors, facts = checkpoint.read(file)
    whole = file.read_bytes()
    target = folder / checkpoint.POLICY
    strategy = changed(facts) | _spoiled(whole) | st.sampled_from(sorted(tensors))

    def check(case: Any) -> bool:
        if isinstance(case, bytes):
            write_atomically(target, case)
        elif isinstance(case, str):
            checkpoint.write(target, {name: value for name, value in tensors.items() if name != case}, facts)
        else:
            checkpoint.write(target, tensors, case)
        return _refused(lambda: load_run(folder))

    return _run(strategy, check, cases, "run directories")


def reports(folder: Path, cases: int) -> dict[str, int]:
    """Directories that a report reads: an evaluation, stored settings and metrics, of which one is changed or is any
    bytes.
    """
    run, made = folder / "reported", 0
    whole = {
        run / "evaluation.json": (EVALUATION, json.dumps(EVALUATION).encode()),
        # JSON is also yaml.
        run / ".hydra" / "config.yaml": (SETTINGS, json.dumps(SETTINGS).encode()),
        run / "metrics.csv": (None, METRICS),
    }
    for path, (_, content) in whole.items():
        write_atomically(path, content)
    strategy = st.one_of(
        [
            st.tuples(st.just(path), st.binary(max_size=100) | (_bytes(changed(plain)) if plain else _spoiled(content)))
            for path, (plain, content) in whole.items()
        ]
    )

    def check(case: tuple[Path, bytes]) -> bool:
        nonlocal made
        path, content = case
        kept = path.read_bytes()
        path.write_bytes(content)
        form = "md" if made % _DRAWN else "html"
        made += 1
        told = {"runs": str(folder), "out": str(folder / f"report.{form}"), "format": form}
        cfg = OmegaConf.merge(OmegaConf.load(plugins.CONF / "report.yaml"), told)
        assert isinstance(cfg, DictConfig)
        try:
            with contextlib.redirect_stdout(io.StringIO()):
                return _refused(lambda: report.report(cfg))
        finally:
            path.write_bytes(kept)

    return _run(strategy, check, cases, "reports")


def _spoiled(whole: bytes) -> st.SearchStrategy[bytes]:
    """``whole`` with up to four bytes replaced or lost somewhere."""
    return st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 4), st.binary(max_size=4)).map(
        lambda c: whole[: c[0]] + c[2] + whole[c[0] + c[1] :]
    )


def overrides(cases: int) -> dict[str, int]:
    """``key=value`` arguments of a training: known and unknown keys with any value, and any text."""
    names = st.sampled_from(KEYS)
    # json.dumps refuses nothing that Python holds, so these are also Hydra's lists and dictionaries.
    value = _text | _value.map(lambda content: json.dumps(content)[:200])
    strategy = st.lists(
        st.tuples(names, st.sampled_from(["=", "", "=="]), value).map("".join) | _text, min_size=1, max_size=3
    )
    schema.register()

    def check(arguments: list[str]) -> bool:
        try:
            cfg = compose("config", ["+task=landing", *arguments])
        except Exception as error:
            return bool(cli.mistake(error))
        return _refused(lambda: schema.validate(cfg))

    return _run(strategy, check, cases, "overrides")
