"""A language model behind one method; any endpoint that speaks OpenAI's protocol, hosted or local."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Iterator
from typing import Any, Protocol
from urllib.parse import urlsplit
from urllib.request import proxy_bypass

from omegaconf import DictConfig

from xqmap.config import schema
from xqmap.errors import UserError, brief
from xqmap.explanations.dialogue import replies
from xqmap.explanations.dialogue.masking import Mask, secrets_of
from xqmap.explanations.dialogue.replies import Unanswered

Message = dict[str, str]
# More than any language needs: an answer beyond it has no end.
_LETTERS_PER_TOKEN = 20
# Tokens of an answer where nothing else limits it.
_MOST_TOKENS = 20_000
# What a refusal is usually about.
_LOOK_AT = {401: "OPENAI_API_KEY", 403: "OPENAI_API_KEY", 404: "llm.base_url and llm.model"}
_PROXIES = ("http_proxy", "https_proxy", "all_proxy")
_IN_HEADERS = ("OPENAI_API_KEY", "OPENAI_ORG_ID", "OPENAI_PROJECT_ID")


class LanguageModel(Protocol):
    """Something that continues a conversation."""

    def complete(self, messages: list[Message]) -> Iterator[str]:
        """The answer to ``messages`` (``role`` and ``content``), piece by piece.

        Raises:
            Unanswered: if there is none.
        """
        ...


class OpenAICompatible:
    """Chat completions over HTTP. Neither key nor passwords are in anything that it says.

    Args:
        base_url: of the endpoint; None takes ``OPENAI_BASE_URL`` or the client's own.
        model: its name; None takes ``XQMAP_LLM_MODEL``.
        temperature: of sampling; None leaves it to the server, as where the server refuses it.
        timeout: seconds until an answer that does not begin, or stops coming, is given up.
        longest: seconds an answer may take in all.
        retries: after a failure that may pass.
        max_tokens: the most an answer may have; None leaves it to the server. One that refuses it is told
            ``max_completion_tokens`` instead, or nothing.
        max_completion_tokens: the same by its newer name, sent instead.

    Raises:
        UserError: if a setting, or a variable of the environment, is none that a server can be asked with.
    """

    def __init__(
        self,
        base_url: str | None,
        model: str | None,
        temperature: float | None,
        timeout: float,
        longest: float,
        retries: int,
        max_tokens: int | None,
        max_completion_tokens: int | None = None,
    ) -> None:
        try:
            import openai  # an extra
        except ImportError:
            raise UserError("llm=openai needs the openai package: pip install 'xqmap[llm]'") from None
        place = "llm.base_url" if base_url else "OPENAI_BASE_URL"
        base_url = str(base_url or os.environ.get("OPENAI_BASE_URL") or "") or None
        key = os.environ.get("OPENAI_API_KEY")
        proxies = [name for name in os.environ if name.lower() in _PROXIES and os.environ[name]]
        addresses = [base_url, *map(os.environ.get, proxies)]
        self._mask = Mask([key or "", *(secret for address in addresses for secret in secrets_of(address))])
        if base_url is not None and not _is_address(base_url):
            raise UserError(
                f"{place}={self._told(base_url)} is no address of a server: give one like http://localhost:11434/v1"
            )
        if not key and base_url is None:
            raise UserError(
                "llm=openai has neither OPENAI_API_KEY nor llm.base_url (a local server needs only the latter)"
            )
        model = model or os.environ.get("XQMAP_LLM_MODEL")
        if not model:
            raise UserError("llm=openai has no model: set llm.model=NAME or XQMAP_LLM_MODEL")
        for name in _IN_HEADERS:
            value = os.environ.get(name, "")
            if not (value.isascii() and value.isprintable()) or " " in value:
                raise UserError(f"{name} holds a space, a line break or another sign that no key has: set it again")
        self._model, self._longest = model, longest
        limit = (
            {"max_completion_tokens": max_completion_tokens} if max_completion_tokens else {"max_tokens": max_tokens}
        )
        sent = {"temperature": temperature, **limit}
        self._optional = {name: value for name, value in sent.items() if value is not None}
        try:
            self._client = openai.OpenAI(
                base_url=base_url, api_key=key or "none", timeout=timeout, max_retries=int(retries)
            )
        except OSError as error:
            certificates = [f"{n}={os.environ[n]}" for n in ("SSL_CERT_FILE", "SSL_CERT_DIR") if os.environ.get(n)]
            raise UserError(
                f"{' or '.join(certificates) or 'the certificate store'} cannot be read ({brief(error)}): "
                "give a file of certificates, or unset the variable"
            ) from None
        except Exception as error:
            # What this library does not take, it says in exceptions of many libraries.
            raise UserError(
                f"{', '.join(proxies) or place} cannot be used: {self._mask(brief(error))} (mend or unset it)"
            ) from None

    def complete(self, messages: list[Message]) -> Iterator[str]:
        """Streams the answer, without the model's thoughts; see :class:`LanguageModel`."""
        said = False
        for piece in self._mask.stream(replies.without_thoughts(self._received(messages))):
            said = said or bool(piece.strip())
            yield piece
        if not said:
            raise Unanswered("the model thought, but did not answer (llm.max_tokens may be too few for both)")

    def _received(self, messages: list[Message]) -> Iterator[str]:
        # Read in a thread, so that a server that keeps the line busy without ever saying anything is given up too.
        pieces: queue.SimpleQueue[str | Exception | None] = queue.SimpleQueue()
        given_up = threading.Event()
        threading.Thread(target=self._read, args=(messages, pieces, given_up), daemon=True).start()
        ends, said = time.monotonic() + self._longest, 0
        try:
            while True:
                try:
                    piece = pieces.get(timeout=max(0.0, ends - time.monotonic()))
                except queue.Empty:
                    raise Unanswered(
                        f"the model's answer did not end within {self._longest:g} s (llm.longest)"
                    ) from None
                if piece is None:
                    return
                if isinstance(piece, Exception):
                    raise self._unanswered(piece) from None
                said += len(piece)
                tokens = self._optional.get("max_tokens") or self._optional.get("max_completion_tokens") or _MOST_TOKENS
                if said > _LETTERS_PER_TOKEN * tokens:
                    raise Unanswered(f"the model's answer is longer than {tokens} tokens (llm.max_tokens)")
                yield piece
        finally:
            given_up.set()

    def _read(
        self, messages: list[Message], pieces: queue.SimpleQueue[str | Exception | None], given_up: threading.Event
    ) -> None:
        import openai  # an extra

        create: Any = self._client.chat.completions.with_streaming_response.create
        try:
            while True:
                try:
                    with create(messages=messages, model=self._model, stream=True, **self._optional) as response:
                        for piece in replies.answer(response.iter_text()):
                            if given_up.is_set():
                                return
                            pieces.put(piece)
                    pieces.put(None)
                    return
                except openai.APIStatusError as error:
                    # Asked again with less, as long as there is something to leave away.
                    if error.status_code not in (400, 422) or not self._optional:
                        raise
                    self._optional = _accepted(self._optional, f"{error.message} {error.body}")
        except Exception as error:
            # Whatever goes wrong while reading is told, or raised, where the answer is awaited.
            pieces.put(error)

    def _unanswered(self, error: Exception) -> Exception:
        """The error as a line for the person; itself where it is none that a server can cause."""
        import openai  # an extra

        # The HTTP library under the client has exceptions of its own for a stream that breaks off.
        from_http = type(error).__module__.split(".")[0] in ("httpx", "httpx2", "httpcore", "httpcore2")
        if isinstance(error, Unanswered):
            return Unanswered(self._told(str(error)))
        if isinstance(error, openai.APIStatusError):
            look = f" (see {_LOOK_AT[error.status_code]})" if error.status_code in _LOOK_AT else ""
            told = self._told(replies.reason(error.body or error.message))
            return Unanswered(f"the model's server answered {error.status_code}: {told}{look}")
        if isinstance(error, openai.APITimeoutError) or (from_http and "Timeout" in type(error).__name__):
            return Unanswered(f"the model did not answer in time (llm.timeout={self._client.timeout} s)")
        if isinstance(error, openai.APIConnectionError):
            return Unanswered(self._unreachable(brief(error.__cause__ or error)))
        if from_http:
            return Unanswered(self._told(f"the model's answer broke off ({type(error).__name__}: {brief(error)})"))
        if isinstance(error, openai.OpenAIError | ValueError | RecursionError | OSError):
            return Unanswered(self._told(f"the model's answer was malformed ({type(error).__name__}: {brief(error)})"))
        return error

    def _unreachable(self, cause: str) -> str:
        address = self._client.base_url
        said = f"no server answers at {self._mask(str(address))} ({self._told(cause)})"
        names = {"all_proxy", f"{address.scheme}_proxy"}
        proxies = [name for name in os.environ if name.lower() in names and os.environ[name]]
        if not proxies or proxy_bypass(address.host):
            return said
        return f"{said}, asked through the proxy of {', '.join(proxies)} (NO_PROXY={address.host} goes around it)"

    def _told(self, text: str, most: int = 200) -> str:
        """A server's words for a person: masked before they are cut, or the rest of a secret would not be known."""
        return self._mask(" ".join(text.split()))[:most]


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        host = (parts.hostname or "").encode("idna")
        return (
            parts.scheme in ("http", "https")
            and parts.port != 0
            and host != b""
            and text.isprintable()
            and " " not in text
        )
    except ValueError:
        return False


def _accepted(optional: dict[str, Any], refusal: str) -> dict[str, Any]:
    """What is left of the optional settings after a refusal: those that it does not name, or none if it names none.

    ``max_tokens`` becomes ``max_completion_tokens`` where the server asks for that.
    """
    named = [name for name in optional if name in refusal]
    kept = {name: value for name, value in optional.items() if named and name not in named}
    if "max_tokens" in named and "max_completion_tokens" in refusal and "max_completion_tokens" not in optional:
        kept["max_completion_tokens"] = optional["max_tokens"]
    return kept


def language_model(settings: DictConfig) -> LanguageModel | None:
    """What answers beside the templates: None for ``llm=template``.

    Raises:
        UserError: naming the setting that is unknown, or that no server can be asked with.
    """
    settings = schema.language_model(settings)
    if settings.name == "template":
        return None
    return OpenAICompatible(**{str(name): value for name, value in settings.items() if name != "name"})
