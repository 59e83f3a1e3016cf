"""``python -m xqmap.explain run=DIR scene_seed=N`` or ``decision=FILE.json``: why this one, in pictures, charts and
sentences.
"""

from __future__ import annotations

from pathlib import Path

from omegaconf import DictConfig
from tqdm import tqdm

from xqmap.config import cli
from xqmap.errors import UserError
from xqmap.explanations import Decision
from xqmap.explanations.dialogue.conversation import excerpt, saved_conversation
from xqmap.explanations.views import plots
from xqmap.explanations.views.page import page
from xqmap.files import require_place, write_atomically
from xqmap.runs.places import default_folder
from xqmap.terminal import say

_SIMULATOR = "xqmap.explanations.perception.Simulator"


def explain(cfg: DictConfig) -> None:
    """Builds or reads the decision, then writes every view of it to ``cfg.out``; of several, each into a folder of its
    own.
    """
    require_rollouts(cfg)
    out = place(cfg)
    decisions = decisions_of(cfg)
    if cfg.rollouts:
        play_out(cfg, decisions)
    folders = [out / f"step{decision.step + 1:02d}" for decision in decisions] if len(decisions) > 1 else [out]
    written = []
    for decision, folder in zip(
        tqdm(decisions, unit="decision", desc="drawing", disable=len(decisions) == 1), folders, strict=True
    ):
        written += write(decision, folder)
    if len(decisions) > 1:
        written += plots.save(plots.over_time(decisions), out / "episode")
        write_atomically(out / "explanation.html", page(decisions).encode())
        written.append(out / "explanation.html")
    for decision in decisions:
        say(
            f"\nDecision {decision.step + 1}: {decision.selected.object}" if len(decisions) > 1 else "",
            decision.why(),
            sep="\n",
        )
    say(f"\nwrote {len(written)} files to {out}: {', '.join(sorted({path.name for path in written}))}")


def place(cfg: DictConfig) -> Path:
    """The folder to write to; to be asked before the work whose results it is to hold.

    Raises:
        UserError: if it is not clear what to explain.
        OSError: if nothing can be written there.
    """
    if cfg.decision is not None and cfg.run is not None:
        raise UserError("give either run=DIR or decision=FILE.json, not both")
    if cfg.images is not None and cfg.run is None:
        raise UserError("images=PLACE needs an agent to decide on them: give run=DIR, too")
    if cfg.decision is None and cfg.run is None:
        raise UserError("nothing to explain: give run=DIR scene_seed=N, or decision=FILE.json")
    out = Path(cfg.out) if cfg.out else default_folder(cfg, "explanation")
    require_place(out / "decision.json")
    return out


def decisions_of(cfg: DictConfig) -> list[Decision]:
    """What ``run=`` and ``scene_seed=``, or ``decision=``, name."""
    if cfg.decision is not None:
        return [Decision.load(cfg.decision)]
    # Torch and the rest take seconds, which a decision from a file need not wait for.
    from xqmap.runs.run import load_run

    steps, run = cli.decisions(cfg), load_run(cfg.run)
    if cfg.images is not None:
        # Of pictures no simulator knows what lies where.
        see = None if cfg.perception.get("_target_") == _SIMULATOR else cfg.perception
        return [run.decide_images(cfg.images, cfg.table, see, cfg.candidates, cfg.depth_unit, cfg.camera_axes)]
    return run.episode(cfg.scene_seed, steps, cfg.perception, cfg.candidates)


def play_out(cfg: DictConfig, decisions: list[Decision]) -> None:
    """Carries out every candidate, ``cfg.rollouts`` times."""
    # As above: torch takes seconds.
    from xqmap.runs import futures
    from xqmap.runs.run import load_run

    futures.play(load_run(cfg.run), decisions, cfg.rollouts)


def require_rollouts(cfg: DictConfig) -> None:
    """Refuses ``cfg.rollouts`` where nothing can be carried out.

    Raises:
        UserError: naming the setting.
    """
    if not isinstance(cfg.rollouts, int) or not 0 <= cfg.rollouts <= 100:
        raise UserError(f"rollouts={cfg.rollouts} must be a whole number from 0 to 100")
    if cfg.rollouts and (cfg.decision is not None or cfg.images is not None):
        raise UserError("rollouts needs a run in its own world: give run=DIR scene_seed=N, without decision or images")


def write(decision: Decision, folder: Path) -> list[Path]:
    """Writes one decision's files into ``folder``; returns them."""
    # What might fail is made before anything is written.
    html = page([decision], conversation(decision, folder))
    folder.mkdir(parents=True, exist_ok=True)
    written = [*decision.save(folder / "decision.json"), folder / "explanation.txt", folder / "explanation.html"]
    write_atomically(folder / "explanation.txt", (decision.why() + "\n").encode())
    write_atomically(folder / "explanation.html", html.encode())
    if decision.maps is None:
        say("qmaps are not drawn: there are no maps (decision.npz) beside the decision file")
    else:
        written += plots.save(plots.qmaps(decision), folder / "qmaps")
    written += plots.save(plots.overview(decision, excerpt(decision)), folder / "overview")
    written += plots.save(plots.values(decision), folder / "values")
    if decision.horizon and decision.foresees:
        written += plots.save(plots.when(decision), folder / "when")
    return written + plots.save(plots.rdx(decision), folder / "rdx")


def conversation(decision: Decision, folder: Path) -> list[tuple[str, str]]:
    """What was asked about this decision (``dialogue.json``, left there by ``python -m xqmap.chat``), or an excerpt."""
    return saved_conversation(folder / "dialogue.json", decision) or excerpt(decision)


main = cli.main("explain")(explain)

if __name__ == "__main__":
    main()
