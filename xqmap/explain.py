"""``python -m xqmap.explain run=DIR scene_seed=N`` or ``decision=FILE.json``: why this one, in pictures, charts and sentences."""

from __future__ import annotations

import json
from pathlib import Path

from omegaconf import DictConfig

from xqmap import checkpoint, cli, commands
from xqmap.errors import UserError
from xqmap.explanations import Decision, plots
from xqmap.explanations.dialogue import excerpt
from xqmap.explanations.page import over_time, page


def explain(cfg: DictConfig) -> None:
    """Builds or reads the decision, then writes every view of it to ``cfg.out``."""
    decisions = decisions_of(cfg)
    out = Path(cfg.out) if cfg.out else commands.default_folder(cfg, "explanation")
    # Everything is made before anything is written.
    html = page(decisions, excerpt(decisions[0]))
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for i, decision in enumerate(decisions):
        folder = out if len(decisions) == 1 else out / f"step{i + 1:02d}"
        written += write(decision, folder)
    if len(decisions) > 1:
        written += plots.save(over_time(decisions), out / "episode")
    checkpoint.write_atomically(out / "explanation.html", html.encode())
    print("\n".join(text(decision) for decision in decisions))
    print(f"wrote {len(written) + 1} files to {out}: {', '.join(sorted({p.name for p in written} | {'explanation.html'}))}")


def decisions_of(cfg: DictConfig) -> list[Decision]:
    """What ``run=`` and ``scene_seed=``, or ``decision=``, name."""
    if cfg.decision is not None:
        if cfg.run is not None:
            raise UserError("give either run=DIR or decision=FILE.json, not both")
        return [Decision.load(cfg.decision)]
    if cfg.run is None:
        raise UserError("nothing to explain: give run=DIR scene_seed=N, or decision=FILE.json")
    if cfg.steps != "all" and not (isinstance(cfg.steps, int) and cfg.steps >= 1):
        raise UserError(f"steps={cfg.steps} is neither a number of decisions from 1 on nor 'all'")
    if not isinstance(cfg.scene_seed, int) or not 0 <= cfg.scene_seed < 2**32:
        raise UserError(f"scene_seed={cfg.scene_seed} must be a whole number of at least 0 and below 2**32")
    run = checkpoint.load_run(cfg.run)
    return commands.decide(run, cfg.scene_seed, None if cfg.steps == "all" else cfg.steps, cfg.perception)


def write(decision: Decision, folder: Path) -> list[Path]:
    """Writes one decision's files into ``folder``; returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    content = json.dumps(decision.to_dict(), indent=1, allow_nan=False) + "\n"
    checkpoint.write_atomically(folder / "decision.json", content.encode())
    checkpoint.write_atomically(folder / "explanation.txt", (text(decision) + "\n").encode())
    written = [folder / "decision.json", folder / "explanation.txt"]
    if decision.maps is None:
        print("qmaps and overview are not drawn: a decision that was read from a file has no maps")
    else:
        written += plots.save(plots.qmaps(decision), folder / "qmaps")
        written += plots.save(plots.overview(decision, excerpt(decision)), folder / "overview")
    written += plots.save(plots.values(decision), folder / "values")
    return written + plots.save(plots.rdx(decision), folder / "rdx")


def text(decision: Decision) -> str:
    """The sentences, one a line."""
    said = decision.sentences()
    return "\n".join([said["shallow"], *said["contrastive"], said["robustness"]])


main = cli.main("explain")(explain)

if __name__ == "__main__":
    main()
