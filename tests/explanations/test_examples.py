"""The examples in docstrings run as they stand; those of the pages are in tests/docs."""

from __future__ import annotations

import doctest

import pytest

from xqmap.explanations import decision
from xqmap.explanations.views import plots


@pytest.mark.parametrize("module", [decision, plots], ids=["decision", "plots"])
def test_docstrings(module: object) -> None:
    result = doctest.testmod(module)  # type: ignore[arg-type]
    assert result.attempted > 0
    assert result.failed == 0
