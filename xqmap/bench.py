"""``python -m xqmap.bench what=update``: measures fast paths beside their plain references, prints a table and JSON."""

from __future__ import annotations

import json
from pathlib import Path

from hydra import compose
from omegaconf import DictConfig

from xqmap import doctor
from xqmap.config import build, cli, schema
from xqmap.errors import UserError
from xqmap.files import require_place, write_atomically
from xqmap.terminal import say


def bench(cfg: DictConfig) -> None:
    """Runs the benchmarks that ``cfg.what`` names and writes ``cfg.out``, if given."""
    # Importing the simulator takes seconds, which a wrong argument need not wait for.
    from xqmap.benchmarks.replay import replay
    from xqmap.benchmarks.robustness.suite import ROBUSTNESS
    from xqmap.benchmarks.speed import BENCHMARKS, Benchmark
    from xqmap.benchmarks.timing import machine  # likewise

    benchmarks = BENCHMARKS | {"replay": Benchmark(replay, 9)}
    known = benchmarks | {name: Benchmark(*what) for name, what in ROBUSTNESS.items()}
    chosen = list(benchmarks) if cfg.what == "all" else [cfg.what]
    if unknown := set(chosen) - set(known):
        raise UserError(f"what={unknown.pop()} is not one of {', '.join(known)}, all")
    if cfg.rounds is not None and not (isinstance(cfg.rounds, int) and cfg.rounds > 0):
        raise UserError(f"rounds={cfg.rounds} must be a whole number above 0")
    if cfg.out is not None:
        require_place(Path(cfg.out))
    settings = compose("config", [f"+task={cfg.task_name}", *cfg.settings])
    schema.validate(settings)
    doctor.require_rendering(build.world(settings))
    results = {name: known[name].run(settings, cfg.perception, cfg.rounds or known[name].rounds) for name in chosen} | {
        "machine": machine()
    }
    for name, measured in results.items():
        shown = [
            f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}" for key, value in measured.items()
        ]
        say(f"{name:<12}{'  '.join(shown)}")
    text = json.dumps(results, indent=1)
    if cfg.out is not None:
        write_atomically(Path(cfg.out), (text + "\n").encode())
        say(f"wrote {cfg.out}")
    else:
        say(text)


main = cli.main("bench")(bench)

if __name__ == "__main__":
    main()
