"""A language model over real HTTP, which may be slow, broken, hostile or gone."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from tests.model_server import Server, asked, events, model
from tests.talks import dialogue
from xqmap import chat
from xqmap.errors import UserError
from xqmap.explanations.dialogue.llm import OpenAICompatible


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
    exchange = chat._reply(talk, "Why?")
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
