"""Keys, addresses and settings of a language model: what cannot be used is named, and nothing secret told."""

from __future__ import annotations

import json
import re

import pytest
from hydra import compose, initialize_config_dir

from tests.model_server import Server, events, model
from tests.talks import dialogue
from xqmap.config import plugins
from xqmap.errors import UserError
from xqmap.explanations.dialogue.llm import OpenAICompatible, language_model
from xqmap.explanations.views.page import page

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
        language_model(settings)


def test_settings_that_fit_make_a_model() -> None:
    with initialize_config_dir(str(plugins.CONF), version_base=None):
        fit = ["llm.base_url=http://h/v1", "llm.model=tiny", "llm.max_tokens=null", "llm.temperature=null"]
        assert language_model(compose("chat", ["llm=openai", *fit]).llm) is not None
        assert language_model(compose("chat").llm) is None
