"""Figures look the same whatever another tool told matplotlib."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import pytest

from tests.commands import start
from tests.evaluation.test_results import write_run
from xqmap.explanations import Candidate, Decision
from xqmap.explanations.views import plots, style

DECISION = Decision(
    "landing",
    ("flatness", "color"),
    [
        Candidate("Selected", "blue $block$", {"flatness": 0.9, "color": 1.0}),
        Candidate("A", "ground", {"flatness": 1.0, "color": 0.1}),
    ],
)
STRANGE = {
    "text.usetex": True,
    "font.family": "Nonsense",
    "font.size": 30,
    "lines.linewidth": 9,
    "axes.grid": True,
    "image.origin": "upper",
    "savefig.format": "pdf",
    "savefig.transparent": True,
    "figure.autolayout": True,
    "axes.unicode_minus": False,
    "path.sketch": (1, 100, 2),
}


def test_a_figure_is_the_same_under_any_settings() -> None:
    def pictures() -> list[bytes]:
        return [style.rendered(plots.bars(DECISION), "png"), style.rendered(plots.rdx(DECISION), "png", dpi=50)]

    usual = pictures()
    with matplotlib.rc_context(STRANGE):
        before = dict(matplotlib.rcParams)
        assert pictures() == usual
        assert dict(matplotlib.rcParams) == before
        with style.drawing({"font.size": 7}):
            assert (matplotlib.rcParams["font.size"], matplotlib.rcParams["axes.titlesize"]) == (7, 11)


# What lies where matplotlib looks for its settings, and a variable.
ENVIRONMENTS = {
    "here": (b"text.usetex: True\nbackend: nonsense\nno such line\nfont.family: Nonsense\n", ""),
    "home/.config/matplotlib": (b"\xff\xfe\x00", ""),
    "named": (b"text.usetex: True\n", "nonsense"),
}


@pytest.mark.parametrize("place", ENVIRONMENTS)
def test_commands_draw_whatever_another_tool_left(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings, backend = ENVIRONMENTS[place]
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / "matplotlibrc").write_bytes(settings)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("MPLBACKEND", backend)
    for name in ("XDG_CONFIG_HOME", "MPLCONFIGDIR"):
        monkeypatch.delenv(name, raising=False)
    if place == "named":
        monkeypatch.setenv("MATPLOTLIBRC", str(tmp_path / place))
    here = tmp_path / "here"
    here.mkdir(exist_ok=True)
    DECISION.save(write_run(here / "runs", "a", 9) / "figures" / "scene7" / "decision.json")
    for command in (
        ["explain", "decision=runs/a/figures/scene7/decision.json", "out=explained"],
        ["report", "runs=runs"],
    ):
        done = start(*command, cwd=here)
        assert done.returncode == 0, done.stderr
        assert "atplotlib" not in done.stderr
    assert (here / "explained" / "values.png").read_bytes() == style.rendered(plots.values(DECISION), "png")
