"""No import circle among modules or among the folders of a package.

An import counts wherever it stands: at a module's head, inside a function, or under
``TYPE_CHECKING``. A circle that is broken by a late import is a circle to its reader.
"""

from graphlib import TopologicalSorter

import grimp
import pytest

from stand_ins.source_trees import FILES, SOURCES

PACKAGES = sorted(path.parent for path in FILES if path.name == "__init__.py")
NAMES = [".".join(path.relative_to(SOURCES).parts) for path in PACKAGES]


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """Return module -> modules that it imports; the package's list of public names is left out."""
    roots = [name for name in NAMES if "." not in name]
    graph = grimp.build_graph(*roots, cache_dir=None)
    found = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    return {name: targets - {name} for name, targets in found.items()} | {"spikingtac": set()}


def test_no_module_imports_itself_by_a_detour(imports: dict[str, set[str]]) -> None:
    TopologicalSorter(imports).prepare()  # a CycleError names the circle


@pytest.mark.parametrize("package", NAMES)
def test_no_two_folders_of_a_package_import_each_other(
    package: str, imports: dict[str, set[str]]
) -> None:
    depth = package.count(".") + 2
    rooms = {name for name in NAMES if name.startswith(f"{package}.") and name.count(".") < depth}
    graph: dict[str, set[str]] = {room: set() for room in rooms}
    for module, targets in imports.items():
        here, *there = (".".join(name.split(".")[:depth]) for name in (module, *targets))
        if here in rooms:
            graph[here] |= rooms.intersection(there) - {here}
    TopologicalSorter(graph).prepare()
