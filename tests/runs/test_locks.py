"""No two processes write to one run directory."""

from __future__ import annotations

from pathlib import Path

import pytest

from xqmap.errors import UserError
from xqmap.runs import locks


def test_a_directory_in_use_is_left_alone(tmp_path: Path) -> None:
    with locks.alone(tmp_path):
        assert locks.held(tmp_path)
        with pytest.raises(UserError, match="another process"), locks.alone(tmp_path):
            pass
    assert not locks.held(tmp_path)
    with locks.alone(tmp_path):
        pass
    assert not locks.held(tmp_path / "nowhere")
