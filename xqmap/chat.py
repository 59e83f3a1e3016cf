"""``python -m xqmap.chat run=DIR scene_seed=N`` or ``decision=FILE.json``: ask the agent about its decision."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from tqdm import tqdm
from yaml import YAMLError

from xqmap.config import build, cli
from xqmap.errors import UserError
from xqmap.explain import decisions_of
from xqmap.explanations.dialogue.conversation import Dialogue, Exchange, scene_line, system_prompt
from xqmap.explanations.views.page import page
from xqmap.explanations.views.sentences import wording_for
from xqmap.runs import checkpoint, commands


def chat(cfg: DictConfig) -> None:
    """Holds the conversation and saves it; with ``question=`` one answer, with ``questions=`` a score."""
    decision = decisions_of(cfg)[-1]
    dialogue = Dialogue(decision, wording_for(decision.task), build.language_model(cfg.llm))
    if cfg.show_prompt:
        print(system_prompt(decision, dialogue.words), scene_line(decision), sep="\n\n", end="\n\n")
    if cfg.questions is not None:
        score(dialogue, Path(cfg.questions))
    elif cfg.question is not None:
        _say(dialogue, str(cfg.question))
    else:
        _converse(dialogue)
    if dialogue.exchanges:
        folder = Path(cfg.out) if cfg.out else commands.default_folder(cfg, "explanation")
        # Beside what python -m xqmap.explain wrote about this decision of an episode.
        step = folder / f"step{decision.step + 1:02d}"
        folder = step if decision.step or step.exists() else folder
        checkpoint.write_atomically(folder / "dialogue.json", dialogue.to_json().encode())
        checkpoint.write_atomically(folder / "dialogue.md", dialogue.to_markdown().encode())
        html = page([decision], [(e.question, e.answer) for e in dialogue.exchanges])
        checkpoint.write_atomically(folder / "explanation.html", html.encode())
        print(f"wrote dialogue.json, dialogue.md and explanation.html to {folder}")


def _converse(dialogue: Dialogue) -> None:
    if sys.stdin.isatty():
        import readline  # noqa: F401 (line editing and history)
    chosen = dialogue.decision.selected.object
    print(f"I chose the {chosen}. Ask me why; 'help' says what I can answer, 'exit' ends.")
    while True:
        try:
            question = input("> ").strip()
        except (EOFError, KeyboardInterrupt):
            print()
            return
        if question.lower().rstrip(".!") in ("exit", "quit", "bye"):
            return
        if question:
            try:
                _say(dialogue, question)
            except KeyboardInterrupt:
                print("\n(stopped)")


def _say(dialogue: Dialogue, question: str) -> Exchange:
    streamed: list[str] = []

    def show(piece: str) -> None:
        streamed.append(piece)
        print(piece, end="", flush=True)

    exchange = dialogue.ask(question, show)
    if streamed:
        print()
    if exchange.failure:
        print(f"({exchange.failure}; from the numbers alone:)")
    if exchange.source == "template":
        print(exchange.answer)
    elif "".join(streamed).strip() != exchange.answer:
        print(f"(so far the model thought; its answer:)\n{exchange.answer}")
    if exchange.ungrounded:
        print(f"(careful: not in this decision: {', '.join(exchange.ungrounded)})")
    return exchange


def score(dialogue: Dialogue, path: Path) -> None:
    """Asks a file of questions and prints how many answers are grounded, and how many say what is expected of them."""
    try:
        questions: Any = OmegaConf.to_container(OmegaConf.load(path))
    except (OSError, OmegaConfBaseException, YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"questions={path} cannot be read ({str(error).splitlines()[0][:80]})") from None
    if (
        not isinstance(questions, list)
        or not questions
        or not all(isinstance(entry, dict) and "ask" in entry for entry in questions)
    ):
        raise UserError(f"questions={path} must be a list of entries with ask, and kind or says")
    exchanges = [dialogue.ask(str(entry["ask"])) for entry in tqdm(questions, unit="question", desc="asking")]
    expected = [as_expected(exchange, entry) for exchange, entry in zip(exchanges, questions, strict=True)]
    for exchange, fits in zip(exchanges, expected, strict=True):
        if exchange.ungrounded or not fits:
            why = (
                f"not in the decision: {', '.join(exchange.ungrounded)}"
                if exchange.ungrounded
                else "not what was expected"
            )
            print(f"{exchange.question}\n  {exchange.answer}\n  ({why})")
    if failures := [exchange.failure for exchange in exchanges if exchange.failure]:
        print(f"{len(failures)} answers are the templates', not the model's ({failures[0]})")
    grounded = sum(not exchange.ungrounded for exchange in exchanges)
    count = len(questions)
    print(f"{count} questions: {grounded / count:.1%} of the answers grounded, {sum(expected) / count:.1%} as expected")


def as_expected(exchange: Exchange, entry: dict[str, Any]) -> bool:
    """Whether an answer says all of ``says`` and, where it came from a template, the question was taken as ``kind``."""
    said = exchange.answer.lower()
    if exchange.source == "template" and exchange.kind != entry.get("kind", exchange.kind):
        return False
    return all(str(word).lower() in said for word in entry.get("says", []))


main = cli.main("chat")(chat)

if __name__ == "__main__":
    main()
