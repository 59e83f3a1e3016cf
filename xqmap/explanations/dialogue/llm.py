"""A language model behind one method; any endpoint that speaks OpenAI's protocol, hosted or local."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Iterator
from typing import Any, Protocol

from xqmap.errors import UserError

Message = dict[str, str]
# More than any language needs: an answer beyond it has no end.
_LETTERS_PER_TOKEN = 20


class Unanswered(Exception):
    """The model gave no usable answer; the message says why in one line."""


class LanguageModel(Protocol):
    """Something that continues a conversation."""

    def complete(self, messages: list[Message]) -> Iterator[str]:
        """The answer to ``messages`` (``role`` and ``content``), piece by piece.

        Raises:
            Unanswered: if there is none.
        """
        ...


class OpenAICompatible:
    """Chat completions over HTTP.

    Args:
        base_url: of the endpoint; None takes ``OPENAI_BASE_URL`` or the client's own.
        model: its name; None takes ``XQMAP_LLM_MODEL``.
        temperature: of sampling.
        timeout: seconds until an answer that does not begin, or stops coming, is given up.
        longest: seconds an answer may take in all.
        retries: after a failure that may pass.
        max_tokens: the most an answer may have.
    """

    def __init__(
        self,
        base_url: str | None,
        model: str | None,
        temperature: float,
        timeout: float,
        longest: float,
        retries: int,
        max_tokens: int,
    ) -> None:
        try:
            import openai
        except ImportError:
            raise UserError("llm=openai needs the openai package: pip install 'xqmap[llm]'") from None
        base_url = base_url or os.environ.get("OPENAI_BASE_URL")
        key = os.environ.get("OPENAI_API_KEY")
        if not key and base_url is None:
            raise UserError(
                "llm=openai has neither OPENAI_API_KEY nor llm.base_url (a local server needs only the latter)"
            )
        model = model or os.environ.get("XQMAP_LLM_MODEL")
        if not model:
            raise UserError("llm=openai has no model: set llm.model=NAME or XQMAP_LLM_MODEL")
        self._model, self._temperature, self._longest, self._max_tokens = model, temperature, longest, max_tokens
        self._client = openai.OpenAI(base_url=base_url, api_key=key or "none", timeout=timeout, max_retries=retries)

    def complete(self, messages: list[Message]) -> Iterator[str]:
        """Streams the answer; see :class:`LanguageModel`."""
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
                    break
                if isinstance(piece, Exception):
                    raise self._unanswered(piece) from None
                said += len(piece)
                if said > _LETTERS_PER_TOKEN * self._max_tokens:
                    raise Unanswered(f"the model's answer is longer than {self._max_tokens} tokens (llm.max_tokens)")
                yield piece
        finally:
            given_up.set()
        if not said:
            raise Unanswered("the model's answer was empty")

    def _read(
        self, messages: list[Message], pieces: queue.SimpleQueue[str | Exception | None], given_up: threading.Event
    ) -> None:
        try:
            create: Any = self._client.chat.completions.create
            settings = {"model": self._model, "temperature": self._temperature, "max_tokens": self._max_tokens}
            with create(messages=messages, stream=True, **settings) as stream:
                for chunk in stream:
                    if given_up.is_set():
                        return
                    if piece := chunk.choices[0].delta.content if chunk.choices else None:
                        pieces.put(piece)
            pieces.put(None)
        except Exception as error:
            # Whatever goes wrong while reading is told, or raised, where the answer is awaited.
            pieces.put(error)

    def _unanswered(self, error: Exception) -> Exception:
        """The error as a line for the person; itself where it is none that a server can cause."""
        import openai

        if isinstance(error, openai.APIStatusError):
            return Unanswered(f"the model's server answered {error.status_code}: {str(error.message)[:120]}")
        if isinstance(error, openai.APITimeoutError):
            return Unanswered(f"the model did not answer in time (llm.timeout={self._client.timeout} s)")
        if isinstance(error, openai.APIConnectionError):
            return Unanswered(f"no server answers at {self._client.base_url}")
        # The HTTP library under the client has exceptions of its own for a stream that breaks off.
        if type(error).__module__.split(".")[0] in ("httpx", "httpx2", "httpcore", "httpcore2"):
            return Unanswered(f"the model's answer broke off ({type(error).__name__})")
        if isinstance(error, openai.OpenAIError | ValueError | AttributeError | IndexError | TypeError | OSError):
            return Unanswered(f"the model's answer was malformed ({type(error).__name__})")
        return error
