"""Stored settings as plain values: read within bounds, without a resolver, by libyaml."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from xqmap.errors import UserError, brief
from xqmap.files import read_bytes

# Bytes of a file; what it holds, ends of lists and dictionaries included; levels of it.
_LARGEST_FILE = 2_000_000
_MOST_EVENTS = 100_000
_DEEPEST = 50


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Reads scalars as OmegaConf does: 1e-4 is a number, 2026-11-26 a text."""

    yaml_implicit_resolvers = {  # noqa: RUF012 (pyyaml's own)
        first: [(tag, pattern) for tag, pattern in known if tag != "tag:yaml.org,2002:timestamp"]
        for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)[eE][-+]?\d+\Z"), list("-+.0123456789")
)


_Texts: type[Any] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)


def read(path: Path, inside: Path | None = None, texts: bool = False) -> Any:
    """What a yaml file holds: dictionaries, lists, texts, numbers, booleans and None, interpolations as they stand.

    Args:
        path: of the file.
        inside: the directory that it has to lie in, wherever links lead; None for any place.
        texts: leave every scalar a text: of a list of words, "no" and "on" are no truth values.

    Raises:
        UserError: naming the file and what is wrong with it.
    """
    content, depth, loader = read_bytes(path, _LARGEST_FILE, inside), 0, _Texts if texts else _Loader
    try:
        # libyaml builds by recursion and checks no depth; an alias of aliases of aliases is small only in the file.
        for count, event in enumerate(yaml.parse(content, loader)):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST or count > _MOST_EVENTS:
                raise UserError(f"{path}: more settings than any training has")
            if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None):
                raise UserError(f"{path}: aliases and types of yaml's are no settings")
        return loader(content).get_single_data()
    except (yaml.YAMLError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not yaml ({brief(error, 80)})") from None
