"""``python -m xqmap.evaluate run=DIR``: plays the saved policy, prints the table, writes ``evaluation.json``."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from xqmap import doctor
from xqmap.config import build, cli
from xqmap.errors import UserError
from xqmap.evaluation import sheets
from xqmap.evaluation.file import evaluation_file
from xqmap.evaluation.run import evaluate_run, require_own
from xqmap.files import require_place
from xqmap.runs.run import load_run


def evaluate(cfg: DictConfig) -> None:
    """Evaluates ``cfg.run`` as it was trained or on ``cfg.sheets``, with what ``cfg.task.env`` and ``cfg.evaluation``
    change.
    """
    run = load_run(cli.required(cfg, "run", "run=DIR, a directory that python -m xqmap.train left"))
    told = {"task": cfg.task, "evaluation": {key: value for key, value in cfg.evaluation.items() if value is not None}}
    wanted = [cfg.sheets] if isinstance(cfg.sheets, str) else list(cfg.sheets)
    played: list[str | None] = [*sheets.chosen(run.cfg.task.name, wanted)] or [None]
    if cfg.out and len(played) > 1:
        raise UserError(f"out={cfg.out} is one file for {len(played)} sheets: leave out away, or name one sheet")
    runs = [
        sheets.applied(run, OmegaConf.merge(sheets.load(run.cfg.task.name, sheet) if sheet else {}, told))
        for sheet in played
    ]
    if not cfg.out:
        for changed, sheet in zip(runs, played, strict=True):
            require_own(evaluation_file(run.directory, sheet), changed.cfg, cfg.task)
    outs = [require_place(Path(cfg.out or evaluation_file(run.directory, sheet))) for sheet in played]
    doctor.require_rendering(build.world(run.cfg))
    for changed, sheet, out in zip(runs, played, outs, strict=True):
        evaluate_run(changed, changed.cfg.evaluation, out, sheet)


main = cli.main("evaluate")(evaluate)

if __name__ == "__main__":
    main()
