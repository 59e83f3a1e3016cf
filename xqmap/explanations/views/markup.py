"""A page and its pieces: tables, figures, pictures. Everything from outside is escaped here."""

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

_STYLE = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
# Nothing may be fetched: not even by what a run's file smuggles into the page.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
_GRAY = re.compile(r"#([0-9a-f]{2})\1\1\b")
_NUMBER = re.compile(r"[-+]?[\d,]*\.?\d+")


def document(title: str, body: str, style: str = "", script: str = "") -> str:
    """A whole page that works from disk and asks for nothing outside.

    Args:
        title: of the window.
        body: its HTML.
        style: CSS besides the one of every page.
        script: JavaScript.
    """
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<title>{escape(title)}</title><style>{_STYLE}{style}</style></head>"
        f"<body>{body}{f'<script>{script}</script>' if script else ''}</body></html>\n"
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str, text_columns: int = 1) -> str:
    """A table; on a page with a script, its columns can be sorted.

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
        f'<th scope="col"{"" if i >= text_columns else " class=text"}>{escape(title)}</th>'
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


def picture(source: Path | bytes, caption: str, width: int, alt: str = "") -> str:
    """A picture without its empty rim, at most ``width`` pixels wide; a line of words where it cannot be read.

    Args:
        source: a file, or what one holds.
        caption: stands below it.
        width: pixels.
        alt: what it shows, for those who do not see it; the caption if not given.
    """
    try:
        with Image.open(io.BytesIO(source) if isinstance(source, bytes) else source) as file:
            image = file.convert("RGB")
    except (OSError, Image.DecompressionBombError, SyntaxError, ValueError):
        name = source.name if isinstance(source, Path) else "This"
        return f'<p class="soft">{escape(name)} cannot be read as a picture.</p>'
    image = ImageOps.expand(image.crop(ImageChops.invert(image).getbbox()), border=10, fill="white")
    image.thumbnail((width, width))
    buffer = io.BytesIO()
    image.save(buffer, format="WEBP", quality=85, method=4)
    data = base64.b64encode(buffer.getvalue()).decode()
    shown = f'width="{image.width}" height="{image.height}" src="data:image/webp;base64,{data}"'
    return (
        f'<figure><img alt="{escape(alt or caption, quote=True)}" '
        f"{shown}><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _themed(level: int) -> str:
    return "var(--paper)" if level == 255 else "var(--line)" if level > 160 else "currentColor"
