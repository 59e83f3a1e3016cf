"""The examples in docstrings and in the README run as they stand."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from tests.explanations.test_decision import made
from xqmap.explanations import decision
from xqmap.explanations.views import plots

README = Path(__file__).parents[2] / "README.md"


@pytest.mark.parametrize("module", [decision, plots], ids=["decision", "plots"])
def test_docstrings(module: object) -> None:
    result = doctest.testmod(module)  # type: ignore[arg-type]
    assert result.attempted > 0
    assert result.failed == 0


def test_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    (example,) = [block for block in blocks if "Decision.load" in block]
    place = re.search(r'Decision\.load\("([^"]*)"\)', example)
    assert place is not None
    made(Selected=(0.93, 1.0), A=(1.0, 0.0), B=(0.02, 1.02)).save(tmp_path / place.group(1))
    known: dict[str, object] = {}
    monkeypatch.chdir(tmp_path)
    exec(example, known)
    assert (tmp_path / "bars.png").stat().st_size > 5000
    assert isinstance(known["decision"], decision.Decision)
