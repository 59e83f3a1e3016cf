"""``python -m xqmap.chat run=DIR scene_seed=N`` or ``decision=FILE.json``: ask the agent about its decision."""

from __future__ import annotations

import sys
from pathlib import Path

from omegaconf import DictConfig
from tqdm import tqdm

from xqmap.config import cli
from xqmap.explain import decisions_of, place
from xqmap.explanations.dialogue import scoring
from xqmap.explanations.dialogue.conversation import Dialogue, Exchange, scene_line, system_prompt
from xqmap.explanations.dialogue.llm import language_model
from xqmap.explanations.views.page import page
from xqmap.explanations.views.sentences import wording_of
from xqmap.files import write_atomically
from xqmap.terminal import say


def chat(cfg: DictConfig) -> None:
    """Holds the conversation and saves it; with ``question=`` one answer, with ``questions=`` a score."""
    questions = scoring.read(Path(cfg.questions)) if cfg.questions is not None else []
    model, folder = language_model(cfg.llm), place(cfg)
    decision = decisions_of(cfg)[-1]
    # Beside what python -m xqmap.explain wrote about this decision of an episode.
    step = folder / f"step{decision.step + 1:02d}"
    folder = step if decision.step or step.exists() else folder
    dialogue = Dialogue(decision, wording_of(decision), model, folder)
    if cfg.show_prompt:
        say(system_prompt(decision, dialogue.words), scene_line(decision), sep="\n\n", end="\n\n")
    if questions:
        asked = [dialogue.ask(entry.ask) for entry in tqdm(questions, unit="question", desc="asking")]
        say(scoring.report(asked, questions))
    elif cfg.question is not None:
        _reply(dialogue, str(cfg.question))
    else:
        _converse(dialogue)
    if dialogue.exchanges:
        write_atomically(folder / "dialogue.json", dialogue.to_json().encode())
        write_atomically(folder / "dialogue.md", dialogue.to_markdown().encode())
        html = page([decision], [(e.question, e.answer) for e in dialogue.exchanges])
        write_atomically(folder / "explanation.html", html.encode())
        say(f"wrote dialogue.json, dialogue.md and explanation.html to {folder}")


def _converse(dialogue: Dialogue) -> None:
    if sys.stdin.isatty():
        import readline  # noqa: F401 (line editing and history)
    chosen = dialogue.decision.selected.object
    say(f"I chose the {chosen}. Ask me why; 'help' says what I can answer, 'exit' ends.")
    while True:
        try:
            question = input("> ").strip()
        except (EOFError, KeyboardInterrupt):
            say()
            return
        if question.lower().rstrip(".!") in ("exit", "quit", "bye"):
            return
        if question:
            try:
                _reply(dialogue, question)
            except KeyboardInterrupt:
                say("\n(stopped)")


def _reply(dialogue: Dialogue, question: str) -> Exchange:
    streamed: list[str] = []

    def show(piece: str) -> None:
        streamed.append(piece)
        say(piece, end="")

    exchange = dialogue.ask(question, show)
    if streamed:
        say()
    if exchange.failure:
        say(f"({exchange.failure}; from the numbers alone:)")
    if exchange.source == "template":
        say(exchange.answer)
    elif "".join(streamed).strip() != exchange.answer:
        say(f"(so far the model thought; its answer:)\n{exchange.answer}")
    if exchange.ungrounded:
        say(f"(careful: not in this decision: {', '.join(exchange.ungrounded)})")
    return exchange


main = cli.main("chat")(chat)

if __name__ == "__main__":
    main()
