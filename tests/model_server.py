"""An OpenAI-compatible server over real HTTP, for tests of what may become of a question."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from tests.talks import dialogue
from xqmap.explanations.dialogue.conversation import Exchange
from xqmap.explanations.dialogue.llm import OpenAICompatible


class Server(ThreadingHTTPServer):
    """An OpenAI-compatible server whose ``behaviour`` the test chooses, or what it ``replies`` to what it was sent:
    status, content type and body.
    """

    behaviour = "good"
    replies: Callable[[dict[str, Any]], tuple[int, str, str]] | None = None
    keys: list[str]
    requests: list[dict[str, Any]]
    daemon_threads = True


class Handler(BaseHTTPRequestHandler):
    server: Server

    def log_message(self, *args: Any) -> None:
        pass

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.requests.append(body)
        self.server.keys.append(self.headers.get("Authorization", ""))
        if self.server.replies is not None:
            return self._send(*self.server.replies(body))
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
        self._send(status, "application/json", json.dumps({"error": {"message": "no", "type": "x"}}))

    def _send(self, status: int, kind: str, body: str) -> None:
        content = body.encode()
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)


def model(server: Server, retries: int = 0, user: str = "") -> OpenAICompatible:
    url = f"http://{user}127.0.0.1:{server.server_address[1]}/v1"
    return OpenAICompatible(url, "tiny", temperature=0.0, timeout=1.0, longest=2.0, retries=retries, max_tokens=50)


def events(*contents: Any, end: str = "data: [DONE]\n\n") -> str:
    """The body of a stream whose pieces have these contents."""
    return "".join(f"data: {json.dumps({'choices': [{'delta': {'content': c}}]})}\n\n" for c in contents) + end


def asked(server: Server, *body: Any, kind: str = "text/event-stream", status: int = 200) -> Exchange:
    """What becomes of "Why?" where the server sends a body."""
    server.replies = lambda sent: (status, kind, "".join(body))
    return dialogue(model=model(server)).ask("Why?")
