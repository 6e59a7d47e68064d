"""What lies beside the package (benchmarks, integrations, scripts) still finds what it imports.

No test runs these programs whole, and pyright reads only ``src``: a module that has moved would
be noticed by the first person who runs one.
"""

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import spikingtac
from stand_ins.programs import program

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


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_a_program_imports_only_what_exists(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [name for found in own_imports(tree) for name in missing_from(*found)] == []


EXAMPLES = [path for path in PROGRAMS if path.parent.name == "examples"]
MOST_LINES = 80


def test_the_examples_go_from_01_to_11() -> None:
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02}_" for number in range(1, 12)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_public_names_only(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    assert f"Run: python examples/{path.name}" in (ast.get_docstring(ast.parse(text)) or "")
    assert not re.search(r"^\s*from spikingtac|^\s*import spikingtac\.", text, re.M)
    used = set(re.findall(r"\bst\.(\w+)", text))
    assert used
    assert used <= set(spikingtac.__all__)


def test_every_mutation_applies_at_one_place_and_names_tests_that_exist() -> None:
    script = program("benchmarks/mutations.py")
    assert len({mutation.name for mutation in script.MUTATIONS}) == len(script.MUTATIONS)
    stale = [one.name for one in script.MUTATIONS if len(script.places(one)) != 1]
    assert stale == [], "the sources have changed: give each the text that stands there now"
    assert [one.name for one in script.MUTATIONS if one.old == one.new] == []
    named = {path for one in script.MUTATIONS for path in one.tests}
    assert [path for path in named if not (PROJECT / path).exists()] == []
