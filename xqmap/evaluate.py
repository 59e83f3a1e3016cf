"""``python -m xqmap.evaluate run=DIR``: plays the saved policy, prints the table, writes ``evaluation.json``."""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from xqmap import checkpoint, cli, commands, doctor, schema


def evaluate(cfg: DictConfig) -> None:
    """Evaluates ``cfg.run`` as it was trained, with what ``cfg.evaluation`` changes."""
    run = checkpoint.load_run(cli.required(cfg, "run", "run=DIR, a directory that python -m xqmap.train left"))
    changed = {name: value for name, value in cfg.evaluation.items() if value is not None}
    run.cfg = schema.typed(OmegaConf.merge(run.cfg, {"evaluation": changed}))
    schema.validate(run.cfg)
    doctor.require_rendering()
    commands.evaluate_run(run, run.cfg.evaluation, Path(cfg.out) if cfg.out else run.directory / "evaluation.json")


main = cli.main("evaluate")(evaluate)

if __name__ == "__main__":
    main()
