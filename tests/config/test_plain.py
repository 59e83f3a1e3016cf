"""Stored settings come back as OmegaConf stored them, and nothing in them is more than a value."""

from __future__ import annotations

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from tests.conftest import toy_settings
from xqmap.config import plain
from xqmap.errors import UserError


def test_what_omegaconf_stores_is_read_as_it_reads_it(tmp_path: Path) -> None:
    cfg = toy_settings()
    odd = {"number": 1e-5, "text": "1e-5", "date": "2026-11-26", "yes": "yes", "none": None, "later": "${oc.env:HOME}"}
    cfg.task.env = odd
    OmegaConf.save(cfg, tmp_path / "a.yaml")
    assert plain.read(tmp_path / "a.yaml") == OmegaConf.to_container(OmegaConf.load(tmp_path / "a.yaml"))
    # Written by hand, or as JSON.
    (tmp_path / "b.yaml").write_text("[1e-5, -3E+7, 1.5, 1_000, e5, 2026-11-26, 'no', off, ~]")
    assert plain.read(tmp_path / "b.yaml") == OmegaConf.to_container(OmegaConf.load(tmp_path / "b.yaml"))


@pytest.mark.parametrize(
    "text",
    [
        "[" * 1_000_000,
        "a: &a [1]\nb: *a",
        "a: &a [*a]",
        "!!python/object/apply:os.system [true]",
        "a: !!binary aGk=",
        "a: !!set {b}",
        "? [a]\n: b",
        "- 1\n" * 200_000,
        "a: [",
        "\x00",
        "a: " + "9" * 5000,
    ],
)
def test_what_no_training_stores_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(UserError, match=r"a.yaml: "):
        plain.read(tmp_path / "a.yaml")
