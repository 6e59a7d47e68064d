"""No import circle among modules or among the folders of a package.

An import counts wherever it stands: at a module's head, inside a function, or under
``TYPE_CHECKING``. A circle that is broken by a late import is a circle to its reader.
"""

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from stand_ins.source_trees import FILES, SOURCES, tree_of

Graph = dict[str, set[str]]


def name_of(path: Path) -> str:
    parts = path.relative_to(SOURCES).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for path in FILES}
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield every name that a tree imports, and for ``from a import b`` also ``a.b``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in MODULES else node.module


@cache
def module_graph() -> Graph:
    """Return module -> modules that it imports; the package's list of public names is left out."""
    graph: Graph = {}
    for name, path in MODULES.items():
        graph[name] = {one for one in imported(tree_of(path)) if one in MODULES and one != name}
    graph["spikingtac"] = set()
    return graph


def folder_graph(package: str, modules: Graph) -> Graph:
    """Return sub-folder -> sub-folders of the same package that its modules import."""
    depth = package.count(".") + 2

    def room(module: str) -> str | None:
        name = ".".join(module.split(".")[:depth])
        inside = module.startswith(package + ".") and name in PACKAGES
        return name if inside else None

    graph: Graph = {}
    for module, targets in modules.items():
        if (here := room(module)) is not None:
            rooms = {there for target in targets if (there := room(target)) is not None}
            graph.setdefault(here, set()).update(rooms - {here})
    return graph


def circle_in(graph: Mapping[str, set[str]]) -> list[str]:
    """Return the modules of one circle, each imported by the next; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_module_imports_itself_by_a_detour() -> None:
    assert circle_in(module_graph()) == []


def test_no_two_folders_of_a_package_import_each_other() -> None:
    modules = module_graph()
    found = {package: circle_in(folder_graph(package, modules)) for package in sorted(PACKAGES)}
    circles = {package for package, circle in found.items() if circle}
    assert not circles, {package: found[package] for package in circles}
