"""Files of others are read within bounds, whatever lies there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from xqmap.errors import UserError
from xqmap.files import read_bytes


def test_a_regular_file_is_read_and_so_is_one_through_a_link_inside(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    (tmp_path / "b").symlink_to("a")
    assert read_bytes(tmp_path / "a", 5) == read_bytes(tmp_path / "b", 5, inside=tmp_path) == b"12345"


@pytest.mark.parametrize("kind", ["pipe", "device", "directory", "large", "nowhere", "circle", "outside"])
def test_anything_else_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    place = tmp_path / "run" / "a"
    if kind == "pipe":
        os.mkfifo(place)
    elif kind == "device":
        place.symlink_to("/dev/zero")
    elif kind == "directory":
        place.mkdir()
    elif kind == "large":
        place.write_bytes(b"123456")
    elif kind == "circle":
        place.symlink_to(place)
    elif kind == "outside":
        (tmp_path / "secret").write_bytes(b"1")
        place.symlink_to(tmp_path / "secret")
    with pytest.raises(UserError, match=f"{place}: "):
        read_bytes(place, 5, inside=tmp_path / "run" if kind == "outside" else None)
