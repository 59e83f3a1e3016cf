"""``python -m xqmap.export run=DIR out=FILE.pt2``: the policy as one file that loads where xqmap is not installed."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig

from xqmap.config import cli
from xqmap.errors import UserError
from xqmap.files import require_place
from xqmap.runs import exported
from xqmap.runs.run import load_run
from xqmap.terminal import say


def export(cfg: DictConfig) -> None:
    """Writes ``cfg.out`` and a json beside it, with ``cfg.onnx`` an ONNX file as well, each held against the policy."""
    run = load_run(cli.required(cfg, "run", "run=DIR, a directory that python -m xqmap.train left"))
    out = Path(cfg.out)
    if out.suffix != ".pt2":
        raise UserError(f"out={out} must end with .pt2")
    require_place(out)
    facts = exported.write(run, out, cfg.onnx)
    for name, worst in facts["difference"].items():
        say(f"{name} and the policy differ by {worst:.1e} at most, and choose the same")
    say(f"wrote {', '.join(map(str, exported.files(out, cfg.onnx)))}")


main = cli.main("export")(export)

if __name__ == "__main__":
    main()
