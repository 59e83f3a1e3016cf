"""The import graph of the packages: who may import whom, and that no way leads back."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

from tests.test_commands import decision_file

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """What is imported when the program runs: not what only types are taken from."""
    return grimp.build_graph("xqmap", "tasks", exclude_type_checking_imports=True, cache_dir=None)


def test_no_import_leads_back_to_where_it_came_from(graph: grimp.ImportGraph) -> None:
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    # Raises CycleError, which names the modules.
    order = list(TopologicalSorter(imports).static_order())
    assert order.index("xqmap.errors") < order.index("xqmap.train")


def test_worlds_and_framework_never_import_each_other(graph: grimp.ImportGraph) -> None:
    for importer, imported in (("xqmap", "tasks"), ("tasks", "xqmap")):
        assert not graph.find_shortest_chains(importer, imported)


def test_an_import_inside_a_function_has_its_reason_beside_it() -> None:
    bare = []
    for path in [*(ROOT / "xqmap").rglob("*.py"), *(ROOT / "tasks").rglob("*.py")]:
        lines = path.read_text(encoding="utf-8").splitlines()
        for function in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(function, ast.FunctionDef):
                for node in ast.walk(function):
                    if isinstance(node, ast.Import | ast.ImportFrom):
                        near = "".join(lines[node.lineno - 4 : node.lineno])
                        if "# " not in near and "try:" not in near:
                            bare.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert not bare


# Each of these takes longer to import than a decision file to explain.
_SLOW = (
    "torch",
    "tensordict",
    "torchrl",
    "wandb",
    "ray",
    "mani_skill",
    "sapien",
    "scipy",
    "matplotlib.pyplot",
    "pandas",
)
_WITHOUT = """
import runpy, sys
sys.modules.update(dict.fromkeys({slow!r}))
sys.argv = {argv!r}
runpy.run_module("xqmap." + sys.argv[0], run_name="__main__")
"""


@pytest.mark.parametrize(
    "argv",
    [
        ["chat", "decision=decision.json", "question=Why not A?"],
        ["explain", "decision=decision.json"],
        ["explain", "--help"],
        ["chat", "--help"],
    ],
    ids=" ".join,
)
def test_a_decision_from_a_file_is_explained_without_what_takes_seconds_to_import(
    argv: list[str], tmp_path: Path
) -> None:
    decision_file(tmp_path)
    program = _WITHOUT.format(slow=_SLOW, argv=argv)
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert "blue flat block" in done.stdout or "--help" in argv
