"""Imports matplotlib before anyone else does, whatever its settings file and ``MPLBACKEND`` hold."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import sys
from pathlib import Path


def _import_with_its_own_settings() -> None:
    """Lets it find the settings that it ships: it looks into the working directory first."""
    for name in [name for name in sys.modules if name.startswith("matplotlib.")]:
        del sys.modules[name]  # what the import that failed left
    spec = importlib.util.find_spec("matplotlib")
    assert spec is not None and spec.origin is not None
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        with contextlib.chdir(Path(spec.origin).parent / "mpl-data"):
            importlib.import_module("matplotlib")
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


_log = logging.getLogger("matplotlib")
_level = _log.level
# Lines of a settings file that it does not know are no trouble here: figures have settings of their own.
_log.setLevel(logging.ERROR)
try:
    importlib.import_module("matplotlib")
except ImportError:
    pass  # whoever draws says that it is missing
except Exception:  # an unknown MPLBACKEND; a file in another encoding, or of another user
    _import_with_its_own_settings()
finally:
    _log.setLevel(_level)
