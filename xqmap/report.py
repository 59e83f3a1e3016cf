"""``python -m xqmap.report runs=DIR``: what a folder of runs learned, as one page, or its table as Markdown or CSV."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from xqmap import cli, results
from xqmap.checkpoint import write_atomically
from xqmap.errors import UserError
from xqmap.reports import tables
from xqmap.reports.page import Report, page
from xqmap.reports.runs import gather

FORMATS = ("html", "md", "csv")


def report(cfg: DictConfig) -> None:
    """Reads the runs under ``cfg.runs``, prints their table and writes it, or the page, to ``cfg.out``."""
    root = cli.required(cfg, "runs", "runs=DIR, a directory that holds runs")
    if cfg.format not in FORMATS:
        raise UserError(f"format={cfg.format} is not one of {', '.join(FORMATS)}")
    out = Path(cfg.out or f"report.{cfg.format}")
    found, left_out = results.collect(root)
    rows = results.table(found, results.paper_figures())
    if cfg.format == "html":
        runs, foreign = gather(Path(root), found)
        left_out |= foreign
        if not runs:
            why = "; ".join(f"{path}: {reason}" for path, reason in list(left_out.items())[:3])
            raise UserError(f"runs={root} holds no run of xqmap" + (f" ({why})" if why else ": train one with python -m xqmap.train"))
        content = page(Report(str(root), runs, rows, left_out))
    elif not rows:
        raise UserError(f"runs={root} holds no evaluation.json to make a table of: python -m xqmap.evaluate run=DIR writes one")
    else:
        content = tables.markdown(rows) if cfg.format == "md" else tables.comma_separated(rows)
    # Half a character, which JSON can hold and no file can, becomes a question mark.
    written = content.encode(errors="replace")
    write_atomically(out, written)
    if rows:
        print(tables.text(rows))
    for path, reason in left_out.items():
        print(f"left out: {path} ({reason})")
    print(f"wrote {out} ({len(written) / 1e6:.1f} MB)")


main = cli.main("report")(report)

if __name__ == "__main__":
    main()
