"""The tutorial runs from its first cell to its last, and is kept without what it printed."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

from tests.documents import ROOT

TUTORIAL = ROOT / "docs" / "tutorial.ipynb"


@pytest.mark.sim
def test_the_tutorial_runs_and_shows_the_page(tmp_path: Path) -> None:
    notebook = nbformat.read(TUTORIAL, as_version=4)
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", [])]
    (page,) = [data for data in shown if "text/html" in data]
    assert "image/png" in page
    assert "I chose to land on" in page["text/html"]
    printed = "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))
    assert printed.count("I chose to land on") >= 3
    assert "I did not understand" not in printed
    assert {"text/plain": "{'flatness': 1.0, 'color': 1.0}"} in shown


def test_the_tutorial_is_kept_without_outputs() -> None:
    notebook = nbformat.read(TUTORIAL, as_version=4)
    nbformat.validate(notebook)
    assert [cell for cell in notebook.cells if cell.get("outputs") or cell.get("execution_count")] == []
