"""Files of others are read within bounds, whatever lies there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from xqmap.errors import UserError
from xqmap.files import forget_unfinished, read_bytes, replacing


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


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / ".a1b2.part.safetensors").write_bytes(b"half")
    (tmp_path / "policy.safetensors").write_bytes(b"whole")
    forget_unfinished(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["policy.safetensors"]


def test_a_file_is_readable_as_any_other_whoever_wrote_it(tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"")
    with replacing(tmp_path / "policy") as beside:
        beside.unlink()
        beside.touch(mode=0o600)  # a library that writes its own way
    assert (tmp_path / "policy").stat().st_mode == (tmp_path / "plain").stat().st_mode
