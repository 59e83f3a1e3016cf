"""``python -m xqmap.report runs=DIR``: what a folder of runs learned, as one page, or its table as Markdown or CSV, and
its charts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tqdm import tqdm

from xqmap.config import cli
from xqmap.errors import UserError
from xqmap.evaluation import results, tables
from xqmap.evaluation.sheets import ALL
from xqmap.explanations.views import plots
from xqmap.files import write_atomically
from xqmap.reports import stories
from xqmap.reports.page import Report, page
from xqmap.reports.runs import Run, gather

FORMATS = ("html", "md", "csv")


def report(cfg: DictConfig) -> None:
    """Reads the runs under ``cfg.runs``, prints their table and writes it, or the page, to ``cfg.out``, and charts to
    ``cfg.figures``.
    """
    root = cli.required(cfg, "runs", "runs=DIR, a directory that holds runs")
    if cfg.format not in FORMATS:
        raise UserError(f"format={cfg.format} is not one of {', '.join(FORMATS)}")
    if cfg.log is not None and cfg.format != "html":
        raise UserError(f"log={cfg.log} keeps the page: format=html makes one")
    out = Path(cfg.out or f"report.{cfg.format}")
    found, left_out = results.collect(root)
    shown = _of_sheets(found, cfg.sheets)
    if cfg.format != "html" and not shown:
        raise UserError(
            f"runs={root} holds no evaluation.json to make a table of: python -m xqmap.evaluate run=DIR writes one"
        )
    runs: list[Run] = []
    names = None
    if cfg.format == "html" or cfg.figures is not None:
        runs, foreign = gather(Path(root), found)
        left_out |= foreign
        if not runs:
            why = "; ".join(f"{path}: {reason}" for path, reason in list(left_out.items())[:3])
            raise UserError(
                f"runs={root} holds no run of xqmap"
                + (f" ({why})" if why else ": train one with python -m xqmap.train")
            )
        names = results.swept(runs)
    rows = results.table(shown, results.paper_figures(), names)
    whole = Report(str(root), runs, rows, left_out)
    if cfg.format == "html":
        content = page(whole)
    elif cfg.format == "md":
        content = tables.markdown(rows)
    else:
        content = tables.comma_separated(rows)
    # Half a character, which JSON can hold and no file can, becomes a question mark.
    written = content.encode(errors="replace")
    write_atomically(out, written)
    if rows:
        print(tables.text(rows))
    for path, reason in left_out.items():
        print(f"left out: {path} ({reason})")
    print(f"wrote {out} ({len(written) / 1e6:.1f} MB)")
    if cfg.log is not None:
        from xqmap.trainers.logger import log_page  # imports ManiSkill, which a report does not need

        Path(cfg.log).mkdir(parents=True, exist_ok=True)
        print(f"logged it to {log_page(out, Path(cfg.log), str(root), cfg.logger)}")
    if cfg.figures is not None:
        saved = _save_figures(whole, Path(cfg.figures))
        print(f"wrote {len(saved)} files to {cfg.figures}: {', '.join(path.name for path in saved)}")


def _of_sheets(found: list[results.Result], told: Any) -> list[results.Result]:
    """The usual evaluations, and those on the sheets that ``told`` names: one, a list of them, or none."""
    wanted = [str(name) for name in (told if OmegaConf.is_list(told) else [] if told is None else [told])]
    there = sorted({result.sheet for result in found if result.sheet})
    if unknown := [name for name in wanted if name not in (*there, ALL)]:
        raise UserError(f"sheets names {unknown[0]!r}; these runs were evaluated on {', '.join(there) or 'none'}")
    return [result for result in found if not result.sheet or ALL in wanted or result.sheet in wanted]


def _save_figures(report: Report, folder: Path) -> list[Path]:
    """The page's charts as files, and of each task the decision that is explained, as one picture."""
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for task in tqdm(report.tasks, unit="task", desc="drawing"):
        if told := stories.best_told(report.trained(task)):
            decision, place, _ = told
            written += plots.save(plots.overview(decision, stories.asked(decision, place)), folder / task)
        for name, figure, _ in report.figures(task):
            written += plots.save(figure, folder / f"{task}-{name}")
    return written


main = cli.main("report")(report)

if __name__ == "__main__":
    main()
