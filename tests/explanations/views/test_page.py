"""A decision's page, as a browser shows it: on a desk and on a phone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.browser import everything_is_drawn, opened
from tests.evaluation.test_results import write_run
from tests.explanations.test_decision import made
from xqmap.evaluation import results
from xqmap.explanations import Decision
from xqmap.explanations.views.page import page
from xqmap.explanations.views.told import told
from xqmap.reports.page import Report
from xqmap.reports.page import page as report_page
from xqmap.reports.runs import gather

# What a phone is wide, and does not scroll sideways for.
PHONE = {"width": 390, "height": 844}
FITS = "document.documentElement.scrollWidth <= window.innerWidth"


@pytest.fixture
def decision() -> Decision:
    """One with maps, and with names that have no place to break."""
    decision = made(Selected=(0.93, 1.0), A=(1.0, 0.0), B=(0.02, 1.02))
    decision.maps = np.random.default_rng(0).random((2, 8, 12)).astype(np.float32)
    decision.heightmap = np.full((4, 8, 12), 90.0, dtype=np.float32)
    for candidate in decision.candidates:
        candidate.pixel = (2, 3)
    decision.candidates[0].object = "<i>" + "unbreakable" * 12
    return decision


def test_a_page_fits_a_phone(decision: Decision, tmp_path: Path) -> None:
    dialogue = [("Why?" * 60, "Because.\n" + "so" * 200)]
    path = tmp_path / "page.html"
    for decisions, level in (([decision], 2), ([decision, decision], 3)):
        html = page(decisions, dialogue)
        path.write_text(html, encoding="utf-8")
        assert html.count(told(decision, level)) == len(decisions)
        with opened(path) as shown:
            everything_is_drawn(shown, charts=len(decisions) + (len(decisions) > 1), pictures=len(decisions))
            assert shown.get_by_role("heading", name="Asked").count() == 1
            assert shown.locator("i").count() == 0
            shown.set_viewport_size(PHONE)
            assert shown.evaluate(FITS)
            # Panels and tables are read by scrolling them, not with a magnifying glass.
            assert shown.locator(".maps img").first.bounding_box()["width"] > 600


def test_a_report_fits_a_phone_and_tells_a_decision_alike(decision: Decision, tmp_path: Path) -> None:
    directory = write_run(tmp_path, "run" * 40, 9)
    decision.save(directory / "figures" / "decision.json")
    found, _ = results.collect(tmp_path)
    runs, _ = gather(tmp_path, found)
    html = report_page(Report("runs", runs, results.table(found)))
    assert told(Decision.load(directory / "figures" / "decision.json"), 4) in html
    (tmp_path / "report.html").write_text(html, encoding="utf-8")
    with opened(tmp_path / "report.html") as shown:
        shown.set_viewport_size(PHONE)
        assert shown.evaluate(FITS)
