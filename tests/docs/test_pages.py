"""The pages hang together without mkdocs, too: links, anchors, pictures, and what stands around them."""

from __future__ import annotations

import re
import tomllib

import pytest
import yaml

from tests.documents import EVERY, PAGES, README, ROOT, Page

VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


class _Loader(yaml.SafeLoader):
    """Of mkdocs' file the plain part."""


NAV = yaml.load((ROOT / "mkdocs.yml").read_text(), _Loader)["nav"]


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Page) -> None:
    for link in page.links:
        place, _, anchor = link.partition("#")
        if place.startswith(("https://", "http://")):
            continue
        target = page if not place else Page((page.path.parent / place).resolve())
        assert target.path.exists(), link
        assert target.path.is_relative_to(ROOT / "docs") or page.path.parent == ROOT, f"{link} leaves the site"
        # mkdocstrings makes these.
        assert not anchor or anchor in target.anchors or anchor.startswith("xqmap."), link


def test_every_page_is_in_the_site_and_every_picture_on_a_page() -> None:
    listed = re.findall(r"[\w/]+\.md", str(NAV))
    assert sorted(listed) == sorted([*(f"{name}.md" for name in PAGES), "paper/table.md"])
    pictures = {path.name for path in (ROOT / "docs").rglob("*.*") if path.suffix in (".png", ".jpg")}
    assert pictures == {link.split("/")[-1] for page in PAGES.values() for link in page.links if "." in link} & pictures
    linked = {link.removeprefix("docs/").removesuffix(".md") for link in README.links if link.endswith(".md")}
    assert set(PAGES) - {"index", "reference"} <= linked


def test_the_readme_is_short_and_begins_with_two_commands() -> None:
    assert len(README.text.splitlines()) <= 150
    assert re.findall(r"^make \w+", README.blocks[0].text, re.MULTILINE) == ["make train", "make test"]


@pytest.mark.parametrize("page", EVERY, ids=lambda page: page.name)
def test_what_make_is_told_is_a_target(page: Page) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    told = [code for code in page.code if code.startswith("make ")]
    told += [line for block in page.blocks if block.language == "bash" for line in block.text.splitlines()]
    named = {found[1] for line in told if (found := re.match(r"make ([\w-]+)", line))}
    assert named <= targets | {"test-fast"}, named - targets


def test_the_version_is_one() -> None:
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == VERSION
    heads = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert heads[:2] == ["Unreleased", VERSION]
    date = re.search(rf"^## {re.escape(VERSION)} - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert date is not None
    assert str(yaml.safe_load((ROOT / "CITATION.cff").read_text())["date-released"]) == date[1]


@pytest.mark.parametrize("form", ["bug", "question", "world"])
def test_issue_forms_are_what_github_takes(form: str) -> None:
    content = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{form}.yml").read_text())
    assert set(content) == {"name", "description", "labels", "body"}
    identifiers = [entry["id"] for entry in content["body"]]
    assert len(set(identifiers)) == len(identifiers)
    assert all(entry["type"] == "textarea" and entry["attributes"]["label"] for entry in content["body"])
    assert any(entry.get("validations", {}).get("required") for entry in content["body"])
