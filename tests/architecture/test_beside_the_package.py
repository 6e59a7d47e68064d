"""What lies beside the package (benchmarks, integrations, scripts) still finds what it imports.

No test runs these programs whole, and pyright reads only ``src``: a module that has moved would
be noticed by the first person who runs one.
"""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PROGRAMS = sorted(
    path
    for folder in ("benchmarks", "examples", "integrations", "scripts")
    for path in (PROJECT / folder).rglob("*.py")
)
OWN = ("spikingtac", "stand_ins")


def own_imports(tree: ast.AST) -> Iterator[tuple[str, list[str]]]:
    """Yield each module of ours that a program imports, and the names that it takes from it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            if node.module.split(".")[0] in OWN:
                yield node.module, [name.name for name in node.names]
        elif isinstance(node, ast.Import):
            yield from ((n.name, []) for n in node.names if n.name.split(".")[0] in OWN)


def missing_from(module_name: str, names: list[str]) -> list[str]:
    if not is_module(module_name):
        return [module_name]
    module = importlib.import_module(module_name)
    absent = [name for name in names if not hasattr(module, name)]
    return [f"{module_name}.{name}" for name in absent if not is_module(f"{module_name}.{name}")]


def is_module(name: str) -> bool:
    """Return whether there is such a module; skip the test if a library of an extra is not."""
    try:
        return importlib.import_module(name) is not None
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] in OWN:
            return False
        pytest.skip(f"{name} needs {error.name}")


def test_a_moved_module_and_a_renamed_function_are_noticed() -> None:
    source = "from spikingtac.stream.nowhere import f\nfrom spikingtac.types import Nothing\n"
    missing = [name for found in own_imports(ast.parse(source)) for name in missing_from(*found)]
    assert missing == ["spikingtac.stream.nowhere", "spikingtac.types.Nothing"]


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_a_program_imports_only_what_exists(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [name for found in own_imports(tree) for name in missing_from(*found)] == []
