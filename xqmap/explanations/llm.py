"""A language model behind one method; any endpoint that speaks OpenAI's protocol, hosted or local."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import Any, Protocol

from xqmap.errors import UserError

Message = dict[str, str]


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
        self, base_url: str | None, model: str | None, temperature: float, timeout: float, longest: float, retries: int, max_tokens: int
    ) -> None:
        try:
            import openai
        except ImportError:
            raise UserError("llm=openai needs the openai package: pip install 'xqmap[llm]'") from None
        base_url = base_url or os.environ.get("OPENAI_BASE_URL")
        key = os.environ.get("OPENAI_API_KEY")
        if not key and base_url is None:
            raise UserError("llm=openai has neither OPENAI_API_KEY nor llm.base_url (a local server needs only the latter)")
        model = model or os.environ.get("XQMAP_LLM_MODEL")
        if not model:
            raise UserError("llm=openai has no model: set llm.model=NAME or XQMAP_LLM_MODEL")
        self._model, self._temperature, self._longest, self._max_tokens = model, temperature, longest, max_tokens
        self._client = openai.OpenAI(base_url=base_url, api_key=key or "none", timeout=timeout, max_retries=retries)

    def complete(self, messages: list[Message]) -> Iterator[str]:
        """Streams the answer; see :class:`LanguageModel`."""
        import openai

        began, pieces = time.monotonic(), 0
        try:
            create: Any = self._client.chat.completions.create
            stream = create(model=self._model, messages=messages, temperature=self._temperature, max_tokens=self._max_tokens, stream=True)
            for chunk in stream:
                if time.monotonic() - began > self._longest or pieces > 4 * self._max_tokens:
                    stream.close()
                    raise Unanswered(f"the model's answer did not end within {self._longest:g} s")
                piece = chunk.choices[0].delta.content if chunk.choices else None
                if piece:
                    pieces += 1
                    yield piece
        except openai.APIStatusError as error:
            raise Unanswered(f"the model's server answered {error.status_code}: {str(error.message)[:120]}") from None
        except openai.APITimeoutError:
            raise Unanswered(f"the model did not answer in time (llm.timeout={self._client.timeout})") from None
        except openai.APIConnectionError:
            raise Unanswered(f"no server answers at {self._client.base_url}") from None
        except Unanswered:
            raise
        except (openai.OpenAIError, ValueError, AttributeError, IndexError, TypeError, OSError) as error:
            raise Unanswered(f"the model's answer was malformed ({type(error).__name__})") from None
        except Exception as error:
            # The HTTP library under the client has exceptions of its own for a stream that breaks off.
            if type(error).__module__.split(".")[0] in ("httpx", "httpx2", "httpcore", "httpcore2"):
                raise Unanswered(f"the model's answer broke off ({type(error).__name__})") from None
            raise
        if not pieces:
            raise Unanswered("the model's answer was empty")
