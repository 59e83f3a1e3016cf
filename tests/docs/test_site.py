"""``make docs``: strictly, and a site that asks for nothing outside."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.documents import PAGES, ROOT

pytest.importorskip("mkdocs", reason="mkdocs is not installed (it is part of the extra dev)")


def test_the_site_is_built_strictly_and_asks_for_nothing_outside(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path / "site")]
    variables = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.stem for path in (tmp_path / "site").glob("*.html")} == {*PAGES, "404"}
    for path in (tmp_path / "site").rglob("*.html"):
        page = path.read_text(encoding="utf-8")
        fetched = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?(https?:)?//", page)
        fetched += re.findall(r"<link\b[^>]*rel=\"?(?:stylesheet|preconnect|preload)\"?[^>]*href=\"?https?://", page)
        assert not fetched, path.name
        # What a docstring refers to in Sphinx's way is a link or plain code.
        assert not re.search(r":(?:class|func|meth|attr|mod):<code>", page), path.name
