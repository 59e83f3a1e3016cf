"""A language model over real HTTP, which may be slow, broken, hostile or gone."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from tests.talks import dialogue
from xqmap.errors import UserError
from xqmap.explanations.dialogue.llm import OpenAICompatible


class Server(ThreadingHTTPServer):
    """An OpenAI-compatible server whose ``behaviour`` the test chooses."""

    behaviour = "good"
    requests: list[dict[str, Any]]
    daemon_threads = True


class Handler(BaseHTTPRequestHandler):
    server: Server

    def log_message(self, *args: Any) -> None:
        pass

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.requests.append(body)
        behaviour = self.server.behaviour
        if behaviour == "busy then good" and len(self.server.requests) == 1:
            return self._fail(500)
        if behaviour == "refuse":
            return self._fail(401)
        if behaviour == "not a stream":
            return self._fail(200)
        self.send_response(200)
        self.send_header("Content-Type", "text/event-stream")
        self.end_headers()
        with contextlib.suppress(OSError):
            self._stream(behaviour)
        return None

    def _stream(self, behaviour: str) -> None:
        if behaviour == "slow":
            time.sleep(5)
        while behaviour == "never a word":
            self.wfile.write(b": still here\n\n")
            self.wfile.flush()
            time.sleep(0.1)
        if behaviour == "malformed":
            self.wfile.write(b"data: {not json\n\n")
            return
        words = ["I chose the blue flat block ", "because its value, 1.96, is ", "the highest."]
        if behaviour == "wrong":
            words = ["The yellow cube has 7.77.\x1b[2J"]
        if behaviour == "empty":
            words = []
        count = 0
        while behaviour in ("endless", "drip") or count < len(words):
            time.sleep(0.3 if behaviour == "drip" else 0)
            piece = {"id": "x", "object": "chat.completion.chunk", "created": 0, "model": "m"}
            piece |= {"choices": [{"index": 0, "delta": {"content": words[count % 3]}, "finish_reason": None}]}
            self.wfile.write(f"data: {json.dumps(piece)}\n\n".encode())
            self.wfile.flush()
            count += 1
        self.wfile.write(b"data: [DONE]\n\n")

    def _fail(self, status: int) -> None:
        content = json.dumps({"error": {"message": "no", "type": "x"}}).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server(("127.0.0.1", 0), Handler)
    server.requests = []
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


def model(server: Server, retries: int = 0) -> OpenAICompatible:
    url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    return OpenAICompatible(url, "tiny", temperature=0.0, timeout=1.0, longest=2.0, retries=retries, max_tokens=50)


def test_a_model_answers_in_pieces_and_is_told_the_scene(server: Server) -> None:
    talk = dialogue(model=model(server))
    pieces: list[str] = []
    exchange = talk.ask("Why?", pieces.append)
    assert (exchange.source, exchange.ungrounded, len(pieces)) == ("llm", [], 3)
    talk.ask("And B?")
    sent = server.requests[-1]["messages"]
    assert [m["role"] for m in sent] == ["system", "user", "assistant", "user"]
    assert "Q_flatness=0.97" in sent[0]["content"]


def test_a_busy_server_is_asked_again(server: Server) -> None:
    server.behaviour = "busy then good"
    assert dialogue(model=model(server, retries=2)).ask("Why?").source == "llm"


def test_what_a_model_makes_up_is_flagged_and_cannot_move_the_cursor(server: Server) -> None:
    server.behaviour = "wrong"
    exchange = dialogue(model=model(server)).ask("Why?")
    assert "7.77" in exchange.ungrounded
    assert any("yellow cube" in found for found in exchange.ungrounded)
    assert "\x1b" not in exchange.answer


@pytest.mark.parametrize(
    "behaviour", ["slow", "refuse", "malformed", "empty", "endless", "drip", "never a word", "not a stream"]
)
def test_a_failing_model_leaves_the_template_answer_and_the_dialogue_goes_on(server: Server, behaviour: str) -> None:
    server.behaviour = behaviour
    talk = dialogue(model=model(server))
    exchange = talk.ask("Why?")
    assert exchange.source == "template"
    assert exchange.failure
    assert "\n" not in exchange.failure
    server.behaviour = "good"
    assert talk.ask("Why?").source == "llm"


def test_no_server_no_key_no_model() -> None:
    gone = OpenAICompatible("http://127.0.0.1:9/v1", "tiny", 0.0, 1.0, 2.0, 0, 50)
    assert "no server answers" in dialogue(model=gone).ask("Why?").failure
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("OPENAI_API_KEY", raising=False)
        patch.delenv("OPENAI_BASE_URL", raising=False)
        with pytest.raises(UserError, match="OPENAI_API_KEY"):
            OpenAICompatible(None, "tiny", 0.0, 1.0, 2.0, 0, 50)
