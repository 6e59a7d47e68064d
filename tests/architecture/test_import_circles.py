"""No import circle among modules or among the folders of a package.

An import counts wherever it stands: at a module's head, inside a function, or under
``TYPE_CHECKING``. A circle that is broken by a late import is a circle to its reader.
"""

from collections.abc import Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter

import grimp
import pytest

from stand_ins.source_trees import FILES, SOURCES

Graph = dict[str, set[str]]
FOLDERS = sorted(path.parent for path in FILES if path.name == "__init__.py")
PACKAGES = [".".join(path.relative_to(SOURCES).parts) for path in FOLDERS]


@cache
def module_graph() -> Graph:
    """Return module -> modules that it imports; the package's list of public names is left out."""
    roots = [name for name in PACKAGES if "." not in name]
    graph = grimp.build_graph(*roots, cache_dir=None)
    found = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    return {name: targets - {name} for name, targets in found.items()} | {"spikingtac": set()}


def circle_in(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the modules of one circle, each imported by the next; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_module_imports_itself_by_a_detour() -> None:
    assert circle_in(module_graph()) == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_two_folders_of_a_package_import_each_other(package: str) -> None:
    depth = package.count(".") + 2
    inside = (name for name in PACKAGES if name.startswith(f"{package}."))
    graph: Graph = {name: set() for name in inside if name.count(".") < depth}
    for module, targets in module_graph().items():
        here, *there = (".".join(name.split(".")[:depth]) for name in (module, *targets))
        if here in graph:
            graph[here] |= graph.keys() & {*there} - {here}
    assert circle_in(graph) == []
