"""Pieces of a page: tables, figures, pictures. Everything from outside is escaped here."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image, ImageChops, ImageOps

from xqmap.explanations.views.style import rendered

_GRAY = re.compile(r"#([0-9a-f]{2})\1\1\b")
_NUMBER = re.compile(r"[-+]?[\d,]*\.?\d+")


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str, text_columns: int = 1) -> str:
    """A table whose columns can be sorted by a click on their head.

    Args:
        head: of the columns.
        rows: texts, one per column.
        caption: says what the table shows.
        text_columns: how many columns on the left hold words; the others hold numbers, set to the right.
    """

    def cell(value: str, i: int) -> str:
        number = _NUMBER.match(value) if i >= text_columns else None
        key = f' data-key="{number[0].replace(",", "")}"' if number else ""
        # Short words stay on one line; a run's name may break before its parts.
        kind = "" if i >= text_columns else ' class="text long"' if len(value) > 28 else ' class="text"'
        return f"<td{kind}{key}>{escape(value).replace('+', '<wbr>+')}</td>"

    titles = "".join(
        f'<th scope="col"{"" if i >= text_columns else " class=text"}><button '
        f'type="button">{escape(title)}</button></th>'
        for i, title in enumerate(head)
    )
    body = "".join(f"<tr>{''.join(cell(value, i) for i, value in enumerate(row))}</tr>" for row in rows)
    return (
        f'<div class="wide"><table class="sortable"><caption>{escape(caption)}</caption>'
        f"<thead><tr>{titles}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def figure(drawn: Figure, caption: str) -> str:
    """A chart as inline SVG in the page's own colors: its grays follow light and dark."""
    unsaid = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    text = rendered(drawn, "svg", {"svg.fonttype": "none", "savefig.bbox": None}, metadata=unsaid).decode()
    svg = _GRAY.sub(lambda found: _themed(int(found[1], 16)), text[text.index("<svg") :])
    # The axes' parts are numbered from 1 in every figure; nothing on the page refers to them.
    svg = re.sub(
        r' id="(figure|axes|patch|text|line2d|matplotlib\.axis|xtick|ytick|legend|PolyCollection'
        r'|FillBetween\w*|LineCollection)_\d+"',
        "",
        svg,
    )
    title = escape(caption, quote=True)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{title}" ', 1)
    return f"<figure>{svg}<figcaption>{title}</figcaption></figure>"


def picture(path: Path, caption: str, width: int, alt: str = "") -> str:
    """A picture file without its empty rim, at most ``width`` pixels wide; a line of words where it cannot be read.

    Args:
        path: of the file.
        caption: stands below it.
        width: pixels.
        alt: what it shows, for those who do not see it; the caption if not given.
    """
    try:
        with Image.open(path) as file:
            image = file.convert("RGB")
    except (OSError, Image.DecompressionBombError, SyntaxError, ValueError):
        return f'<p class="soft">{escape(path.name)} cannot be read as a picture.</p>'
    image = ImageOps.expand(image.crop(ImageChops.invert(image).getbbox()), border=10, fill="white")
    image.thumbnail((width, width))
    buffer = io.BytesIO()
    image.save(buffer, format="WEBP", quality=85, method=4)
    data = base64.b64encode(buffer.getvalue()).decode()
    source = f'width="{image.width}" height="{image.height}" src="data:image/webp;base64,{data}"'
    return (
        f'<figure><img alt="{escape(alt or caption, quote=True)}" '
        f"{source}><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _themed(level: int) -> str:
    return "var(--paper)" if level == 255 else "var(--line)" if level > 160 else "currentColor"
