"""The documentation as tests read it: pages, their blocks of code, links, anchors, and what stands in backticks."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).parents[1]
_FENCE = re.compile(r"^```(\w*)(?: title=\"([^\"]*)\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """What stands between fences: its language, the file that its title names, its text."""

    language: str
    title: str
    text: str


@dataclass(frozen=True)
class Page:
    """One Markdown file."""

    path: Path

    @property
    def name(self) -> str:
        return str(self.path.relative_to(ROOT))

    @cached_property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @property
    def blocks(self) -> list[Block]:
        return [Block(*found) for found in _FENCE.findall(self.text)]

    def python(self, word: str) -> str:
        """The one Python block that has this word in it."""
        (found,) = [block.text for block in self.blocks if block.language == "python" and word in block.text]
        return found

    @property
    def files(self) -> dict[str, str]:
        """The files that the page has its reader write, by name."""
        return {block.title: block.text for block in self.blocks if block.title}

    @cached_property
    def prose(self) -> str:
        """The page without its blocks."""
        return _FENCE.sub("", self.text)

    @property
    def code(self) -> list[str]:
        """What stands in backticks in the prose; of what breaks over a line, one line."""
        return [" ".join(found.split()) for found in re.findall(r"`([^`]+)`", self.prose)]

    @property
    def links(self) -> list[str]:
        """What links and pictures lead to."""
        return re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", self.prose))

    @property
    def anchors(self) -> set[str]:
        """Of its headings, as GitHub and mkdocs make them."""
        heads = re.findall(r"^#+ (.*)$", self.prose, re.MULTILINE)
        return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", head.lower()).strip()) for head in heads}

    def table(self, first: str) -> list[list[str]]:
        """The rows of the one table whose head begins with this cell; code without its backticks."""
        found = re.findall(rf"^\| *{re.escape(first)} *\|.*\n\|[-:| ]+\|\n((?:\|.*\n?)+)", self.text, re.MULTILINE)
        return [[cell.strip().replace("`", "") for cell in row.strip("|").split("|")] for part in found
                for row in part.strip().splitlines()]  # fmt: skip

    @property
    def commands(self) -> list[list[str]]:
        """The arguments of every ``python -m xqmap.COMMAND`` on the page, the command's name first."""
        shell = "\n".join(block.text for block in self.blocks if block.language == "bash")
        lines = [*shell.splitlines(), *self.code]
        told = [re.search(r"python -m xqmap\.(\w+)((?: (?!#|→).*)?)", line) for line in lines]
        return [[found[1], *_words(found[2])] for found in told if found]


def _words(text: str) -> list[str]:
    """As a shell parts them, up to a comment."""
    return [re.sub(r"[\"']", "", word) for word in re.findall(r"(?:[^\s\"'#]|\"[^\"]*\"|'[^']*')+|#.*", text)
            if not word.startswith("#")]  # fmt: skip


README = Page(ROOT / "README.md")
PAGES = {page.path.stem: page for page in map(Page, sorted((ROOT / "docs").glob("*.md")))}
EVERY = [README, Page(ROOT / "CONTRIBUTING.md"), Page(ROOT / "CHANGELOG.md"), *PAGES.values()]
