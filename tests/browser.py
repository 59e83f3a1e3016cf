"""Pages in Chromium, for tests that look at what a person would."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """A page from disk, which must say nothing on the console and ask for nothing outside; skips where there is no
    browser.
    """
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: as root, apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api")
    said: list[str] = []
    asked: list[str] = []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(path.as_uri())
        yield page
        browser.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def table(page: Any, index: int = 0) -> list[dict[str, str]]:
    """The rows of a table on the page, by the words of its head."""
    found = page.locator("table").nth(index)
    head = found.locator("thead button").all_inner_texts()
    rows = [row.locator("td").all_inner_texts() for row in found.locator("tbody tr").all()]
    return [dict(zip(head, row, strict=True)) for row in rows]


def everything_is_drawn(page: Any, charts: int, pictures: int) -> None:
    """So many charts and at least so many pictures, each with words for who does not see it; and the page prints."""
    drawn = page.locator("figure svg")
    assert drawn.count() == charts
    assert all(chart.get_attribute("aria-label") and chart.bounding_box()["height"] > 50 for chart in drawn.all())
    assert page.locator("img").count() >= pictures
    assert page.evaluate("[...document.images].every((image) => image.naturalWidth > 100 && image.alt)")
    assert len(page.pdf()) > 10_000
