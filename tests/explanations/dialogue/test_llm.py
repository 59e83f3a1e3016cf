"""A language model over real HTTP, which may be slow, broken, hostile or gone."""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from hydra import compose, initialize_config_dir

from tests.talks import dialogue
from xqmap import chat
from xqmap.config import build, plugins
from xqmap.errors import UserError
from xqmap.explanations.dialogue.conversation import Exchange
from xqmap.explanations.dialogue.llm import OpenAICompatible
from xqmap.explanations.views.page import page


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


@pytest.fixture(autouse=True)
def unset(monkeypatch: pytest.MonkeyPatch) -> None:
    """No key, address or proxy of whoever runs the tests."""
    for name in os.environ:
        if name.startswith(("OPENAI_", "SSL_CERT_")) or name.lower().endswith("_proxy"):
            monkeypatch.delenv(name)


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server(("127.0.0.1", 0), Handler)
    server.requests, server.keys = [], []
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.shutdown()
    server.server_close()


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


@pytest.mark.parametrize(
    "content",
    [
        "The blue one.",
        ["The ", "blue one."],
        [{"type": "text", "text": "The "}, {"type": "text", "text": {"value": "blue one."}}],
        [
            {"type": "thinking", "thinking": [{"type": "text", "text": "red?"}]},
            {"type": "text", "text": "The blue one."},
        ],
        {"type": "output_text", "text": "The blue one."},
        {"content": ["The blue one."]},
    ],
)
def test_a_content_is_a_text_or_parts_of_one(server: Server, content: Any) -> None:
    assert asked(server, events(content)).answer == "The blue one."
    whole = json.dumps({"choices": [{"message": {"content": content}, "finish_reason": "stop"}]}, indent=1)
    assert asked(server, whole, kind="application/json").answer == "The blue one."


@pytest.mark.parametrize("content", [1.96, 0, True])
def test_a_content_that_is_a_number_is_an_answer(server: Server, content: Any) -> None:
    exchange = asked(server, events("Its value is ", content))
    assert (exchange.answer, exchange.source) == (f"Its value is {content}", "llm")


@pytest.mark.parametrize("content", [None, [], {}, "", "  ", [None], {"type": "image"}])
def test_a_content_without_words_is_no_answer(server: Server, content: Any) -> None:
    exchange = asked(server, events(content))
    assert exchange.source == "template" and exchange.failure


@pytest.mark.parametrize(
    "pieces",
    [
        ["<think>the red one is 7.77</think>The blue one."],
        ["<thi", "nk>the red", " one < 7.77</t", "hink>", "\n\nThe blue one."],
        list("<think>red</think>The blue <think>hm</think>one."),
        ["<THINKING>\nred\n</THINKING>\nThe blue one."],
        ["[THINK]red[/THINK]The blue one."],
        ["red, it seems", "</think>", "The blue one."],
        ["The blue one.", "<think>or is it? 7.77"],
    ],
)
def test_thoughts_are_no_part_of_an_answer(
    server: Server, pieces: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    server.replies = lambda sent: (200, "text/event-stream", events(*pieces))
    talk = dialogue(model=model(server))
    exchange = chat._say(talk, "Why?")
    assert (exchange.answer, exchange.ungrounded) == ("The blue one.", [])
    assert capsys.readouterr().out.endswith("The blue one.\n")
    talk.ask("And now?")
    assert "red" not in json.dumps(server.requests[-1]["messages"][1:])
    assert "think" not in talk.to_json().lower()


def test_thoughts_without_an_answer_are_a_failure_and_never_shown(server: Server) -> None:
    shown: list[str] = []
    server.replies = lambda sent: (200, "text/event-stream", events("<think>the red one", " is 7.77"))
    exchange = dialogue(model=model(server)).ask("Why?", shown.append)
    assert exchange.source == "template" and "llm.max_tokens" in exchange.failure
    assert not shown


def test_other_signs_that_look_like_a_tag_are_kept(server: Server) -> None:
    assert asked(server, events("1.96 <", " 2 [", "A] <thin")).answer == "1.96 < 2 [A] <thin"


@pytest.mark.parametrize(
    ("status", "refused", "message"),
    [
        (400, {"max_tokens"}, "Unsupported parameter: 'max_tokens', use 'max_completion_tokens' instead."),
        (400, {"max_tokens", "max_completion_tokens"}, "max_tokens is not permitted"),
        (400, {"temperature"}, "'temperature' does not support 0.0 with this model"),
        (422, {"temperature", "max_tokens"}, "Extra inputs are not permitted"),
        (400, {"temperature", "max_tokens"}, "temperature and max_tokens are unknown; is it max_completion_tokens?"),
    ],
)
def test_what_a_server_refuses_is_left_away(server: Server, status: int, refused: set[str], message: str) -> None:
    def replies(sent: dict[str, Any]) -> tuple[int, str, str]:
        if refused & sent.keys():
            return status, "application/json", json.dumps({"error": {"message": message}})
        return 200, "text/event-stream", events("The blue one.")

    server.replies = replies
    talk = dialogue(model=model(server))
    assert talk.ask("Why?").answer == "The blue one."
    needed = len(server.requests)
    assert needed <= 3
    assert ("max_completion_tokens" in server.requests[-1]) == ("completion" in message)
    assert talk.ask("And B?").answer == "The blue one."
    assert len(server.requests) == needed + 1


def test_null_is_not_sent(server: Server) -> None:
    url = f"http://127.0.0.1:{server.server_address[1]}/v1"
    for limits, sent in (
        ((None, None), set()),
        ((None, 70), {"max_completion_tokens"}),
        ((50, 70), {"max_completion_tokens"}),
    ):
        talk = dialogue(model=OpenAICompatible(url, "tiny", None, 1.0, 2.0, 0, *limits))
        assert talk.ask("Why?").source == "llm"
        assert server.requests[-1].keys() == {"model", "messages", "stream"} | sent


@pytest.mark.parametrize(
    ("kind", "body", "told"),
    [
        (
            "text/event-stream",
            events("I chose", end='data: {"error": {"message": "out of memory"}}\n\n'),
            "out of memory",
        ),
        ("text/event-stream", events("I chose", end='event: error\ndata: {"error": "overloaded"}\n\n'), "overloaded"),
        ("text/event-stream", events("I chose", end='error: {"code": 500, "message": "slot gone"}\n\n'), "slot gone"),
        ("text/event-stream", events("I", end='data: {"choices": [{"error": {"message": "died"}}]}\n\n'), "died"),
        ("text/event-stream", events(end='data: {"object": "error", "message": "no such model"}\n\n'), "no such model"),
        ("text/event-stream", events("I chose", end="data: Internal Server Error\n\n"), "Internal Server Error"),
        ("text/event-stream", events("I chose", end=""), "broke off"),
        ("text/event-stream", "", "broke off"),
        ("application/json", '{"error": {"message": "model is loading"}}', "model is loading"),
        ("text/plain", '{"error": "model is loading"}', "model is loading"),
        ("application/json", '{"detail": "Not Found"}', "Not Found"),
        ("application/json", '"quota"', "quota"),
        (
            "text/html",
            "<html><head><title>Welcome to nginx!</title></head><body>x</body></html>",
            "llm.base_url.*nginx",
        ),
        ("text/html", "<p>Sign in &amp; go on</p>", "Sign in & go on"),
        ("text/plain", "upstream connect error", "upstream connect error"),
        (
            "text/event-stream",
            events(end='data: {"choices": [{"delta": {}, "finish_reason": "length"}]}\n\n'),
            "max_tokens",
        ),
        ("text/event-stream", "data: " + "x" * 2_000_000, "malformed"),
        ("text/plain", "xx\n" * 600_000, "something else"),
    ],
)
def test_the_cause_of_a_failure_is_told(server: Server, kind: str, body: str, told: str) -> None:
    exchange = asked(server, body, kind=kind)
    assert exchange.source == "template"
    assert re.search(told, exchange.failure), exchange.failure
    assert exchange.failure.isprintable() and len(exchange.failure) < 400


@pytest.mark.parametrize(
    ("status", "body", "told"),
    [
        (401, '{"error": {"message": "bad key"}}', "401: bad key.*OPENAI_API_KEY"),
        (404, '{"error": {"message": "no model tiny"}}', r"404: no model tiny.*llm\.model"),
        (502, "<html><title>502 Bad Gateway</title></html>", "502: 502 Bad Gateway"),
        (400, '{"detail": [{"loc": ["body"], "msg": "no messages"}]}', "no messages"),
        (500, "", "500"),
    ],
)
def test_a_status_is_told_with_the_servers_words(server: Server, status: int, body: str, told: str) -> None:
    assert re.search(told, asked(server, body, kind="text/html", status=status).failure)


KEY = "sk-proj-A1b2C3d4E5f6G7h8"


def test_a_key_that_a_server_echoes_is_masked(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", KEY)
    refusal = json.dumps({"error": {"message": "x" * 190 + f" {KEY} is unknown, and {KEY[:20]} too (sk-proj-***G7h8)"}})
    for answer in (
        (401, "application/json", refusal),
        (200, "text/event-stream", events("The key is ", *KEY, ".")),
        (200, "text/event-stream", events(KEY[:9], KEY[9:], "!")),
        (200, "text/html", f"<title>{KEY}</title>"),
        (200, "application/json", json.dumps({"error": f"?key={KEY}"})),
        (200, "text/event-stream", events("I chose", end=f"data: {KEY}\n\n")),
    ):
        server.replies = lambda sent, answer=answer: answer  # type: ignore[misc]
        talk, shown = dialogue(model=model(server)), [""]
        exchange = talk.ask("Why?", shown.append)
        assert server.keys[-1] == f"Bearer {KEY}"
        out = (
            "".join(shown)
            + exchange.failure
            + talk.to_json()
            + talk.to_markdown()
            + page([talk.decision], [(exchange.question, exchange.answer)])
        )
        assert KEY[:16] not in out, exchange
        assert "***" in exchange.answer + exchange.failure or len(exchange.failure) > 190


def test_a_password_in_the_address_is_never_told(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    refusal = "Basic bWU6aHVudGVyKzI= of me:hunter+2, hunter%2B2 or hunter%2b2 is wrong"
    server.replies = lambda sent: (401, "text/plain", refusal)
    exchange = dialogue(model=model(server, user="me:hunter%2B2@")).ask("Why?")
    assert "401" in exchange.failure and "hunter" not in exchange.failure and "bWU6aHVudGVyKzI" not in exchange.failure
    gone = OpenAICompatible("http://me:hunter2@127.0.0.1:9/v1", "tiny", 0.0, 1.0, 2.0, 0, 50)
    failure = dialogue(model=gone).ask("Why?").failure
    assert "127.0.0.1:9" in failure and "hunter2" not in failure
    for address in ("http://me:hunter2@127.0.0.1:port/v1", "me:hunter2@nowhere", "http://me:hunt/er2@h/v1"):
        with pytest.raises(UserError, match=r"llm\.base_url") as caught:
            OpenAICompatible(address, "tiny", 0.0, 1.0, 2.0, 0, 50)
        assert "er2" not in str(caught.value)


@pytest.mark.parametrize(
    "address",
    [
        "7",
        "nonsense",
        "localhost:11434/v1",
        "ftp://h/v1",
        "http://",
        "http://h:99999/v1",
        "http://h:a/v1",
        "http://a b/v1",
        "http://[::1/v1",
        "http://a..b/v1",
        "http://h/v1\n",
    ],
)
def test_an_address_that_is_none_is_told_with_its_setting(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match=r"^llm\.base_url=.* is no address"):
        OpenAICompatible(address, "tiny", 0.0, 1.0, 2.0, 0, 50)
    monkeypatch.setenv("OPENAI_BASE_URL", address)
    with pytest.raises(UserError, match=r"^OPENAI_BASE_URL=.* is no address"):
        OpenAICompatible(None, "tiny", 0.0, 1.0, 2.0, 0, 50)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("OPENAI_API_KEY", f"{KEY}\n", "line break"),
        ("OPENAI_API_KEY", f"{KEY[:8]}\n{KEY[8:]}", "line break"),
        ("OPENAI_API_KEY", "sk-é", "sign that no key has"),
        ("OPENAI_ORG_ID", "a\nb", "line break"),
        ("SSL_CERT_FILE", "/nowhere/ca.pem", "No such file"),
        ("SSL_CERT_FILE", __file__, "certificate"),
        ("ALL_PROXY", "socks5://127.0.0.1:9", "SOCKS"),
        ("all_proxy", "nothing://127.0.0.1:9", "scheme"),
        ("HTTPS_PROXY", "http://h:port", "port"),
    ],
)
def test_a_variable_that_cannot_be_used_is_named(
    name: str, value: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(UserError, match=rf"^{name}.*{told}") as caught:
        OpenAICompatible("http://127.0.0.1:9/v1", "tiny", 0.0, 1.0, 2.0, 0, 50)
    assert KEY[:8] not in str(caught.value)


def test_a_proxy_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://me:hunter2@127.0.0.1:9")
    said = dialogue(model=OpenAICompatible("http://h.invalid/v1", "tiny", 0.0, 1.0, 2.0, 0, 50)).ask("Why?").failure
    assert "http_proxy" in said and "NO_PROXY=h.invalid" in said and "hunter2" not in said
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    gone = dialogue(model=OpenAICompatible("http://127.0.0.1:9/v1", "tiny", 0.0, 1.0, 2.0, 0, 50)).ask("Why?").failure
    assert "no server answers" in gone and "refused" in gone and "proxy" not in gone


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("llm.timeout=-1", "llm.timeout"),
        ("llm.timeout=0", "llm.timeout"),
        ("llm.timeout=soon", "llm.timeout"),
        ("llm.timeout=1e300", "llm.timeout"),
        ("llm.longest=nan", "llm.longest"),
        ("llm.retries=-1", "llm.retries"),
        ("llm.retries=2.5", "llm.retries"),
        ("llm.retries=null", "llm.retries"),
        ("llm.max_tokens=0", "llm.max_tokens"),
        ("llm.temperature=hot", "llm.temperature"),
        ("llm.temperature=-1", "llm.temperature"),
        ("llm.model=[a,b]", "llm.model"),
        ("+llm.tokens=5", "llm.tokens"),
        ("llm.name=other", "llm.name"),
        ("llm.base_url=7", "llm.base_url"),
    ],
)
def test_a_setting_of_a_model_is_checked(setting: str, named: str) -> None:
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        settings = compose("chat", ["llm=openai", setting]).llm
    with pytest.raises(UserError, match=rf"^{re.escape(named)}\b"):
        build.language_model(settings)


def test_settings_that_fit_make_a_model() -> None:
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        fit = ["llm.base_url=http://h/v1", "llm.model=tiny", "llm.max_tokens=null", "llm.temperature=null"]
        assert build.language_model(compose("chat", ["llm=openai", *fit]).llm) is not None
        assert build.language_model(compose("chat").llm) is None
