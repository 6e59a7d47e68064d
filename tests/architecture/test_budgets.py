"""Size, documentation and annotation budgets, read from the syntax trees."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "spikingtac"
FILES = sorted(PACKAGE.rglob("*.py"))
FILE_LINES = 300
FUNCTION_LINES = 40
PARAMETERS = 6

Function = ast.FunctionDef | ast.AsyncFunctionDef


def named(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


def functions(tree: ast.AST) -> Iterator[Function]:
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def length_without_docstring(function: Function) -> int:
    body = function.body
    lines = (function.end_lineno or 0) - function.lineno + 1
    if ast.get_docstring(function) is not None:
        lines -= (body[0].end_lineno or 0) - body[0].lineno + 1
    return lines


def parameters(function: Function) -> list[ast.arg]:
    arguments = function.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    every += [extra for extra in (arguments.vararg, arguments.kwarg) if extra]
    return [argument for argument in every if argument.arg not in ("self", "cls")]


def is_kernel(function: Function) -> bool:
    """Numba kernels take arrays and scalars one by one; they cannot take a config."""
    return function.name.endswith("_kernel")


def public_nodes(body: list[ast.stmt]) -> Iterator[Function | ast.ClassDef]:
    for node in body:
        if isinstance(node, Function | ast.ClassDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from public_nodes(node.body)


def is_overload_of_documented(node: Function | ast.ClassDef) -> bool:
    """A property's setter is documented by its getter, an override by what it overrides."""
    return any(
        (isinstance(item, ast.Name) and item.id in ("overload", "override"))
        or (isinstance(item, ast.Attribute) and item.attr == "setter")
        for item in node.decorator_list
    )


@pytest.mark.parametrize("path", FILES, ids=named)
def test_file_is_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= FILE_LINES


@pytest.mark.parametrize("path", FILES, ids=named)
def test_functions_are_short_and_take_few_parameters(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    long = {
        function.name: length_without_docstring(function)
        for function in functions(tree)
        if length_without_docstring(function) > FUNCTION_LINES
    }
    wide = {
        function.name: len(parameters(function))
        for function in functions(tree)
        if len(parameters(function)) > PARAMETERS and not is_kernel(function)
    }
    assert (long, wide) == ({}, {})


@pytest.mark.parametrize("path", FILES, ids=named)
def test_everything_is_annotated(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bare = []
    for function in functions(tree):
        if function.returns is None and not is_kernel(function):
            bare.append(f"{function.name} -> ?")
        if not is_kernel(function):
            untyped = [item.arg for item in parameters(function) if item.annotation is None]
            bare += [f"{function.name}({name})" for name in untyped]
    assert bare == []


@pytest.mark.parametrize("path", FILES, ids=named)
def test_every_public_name_has_a_docstring(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    if path.read_text(encoding="utf-8").strip():
        assert ast.get_docstring(tree), "the module has none"
    if path.name.startswith("_") and path.name != "__init__.py":
        return
    silent = [
        node.name
        for node in public_nodes(tree.body)
        if ast.get_docstring(node) is None and not is_overload_of_documented(node)
    ]
    assert silent == []


def test_no_drawers_named_utils() -> None:
    names = {"utils", "util", "helpers", "misc", "common", "manager"}
    assert [named(path) for path in FILES if path.stem in names] == []


def test_the_library_prints_nothing() -> None:
    printing = []
    for path in FILES:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
        if any(isinstance(call.func, ast.Name) and call.func.id == "print" for call in calls):
            printing.append(named(path))
    assert printing == []


def test_nothing_is_pickled() -> None:
    text = {named(path): path.read_text(encoding="utf-8") for path in FILES}
    assert [name for name, source in text.items() if "import pickle" in source] == []
    assert [name for name, source in text.items() if "allow_pickle=True" in source] == []
