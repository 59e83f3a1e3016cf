"""The import graph of the packages: who may import whom, and that no way leads back."""

from __future__ import annotations

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

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
