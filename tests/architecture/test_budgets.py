"""Budgets of size, read from the syntax trees; ruff checks docstrings, annotations, prints."""

import ast
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

from stand_ins.source_trees import FILES, PACKAGE, SOURCES, code_lines, text_of, tree_of

FILE_LINES = 300  # In the product all lines, in the other packages those that hold code.
FUNCTION_LINES = 40
PARAMETERS = 6
FOLDER_FILES = 26  # Rooms are flat: a file a step, no folder within a folder for its own sake.

Function = ast.FunctionDef | ast.AsyncFunctionDef


def named(path: Path) -> str:
    return str(path.relative_to(SOURCES))


@cache
def functions(path: Path) -> list[Function]:
    return [node for node in ast.walk(tree_of(path)) if isinstance(node, Function)]


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


def complaints(of_file: Callable[[Path], list[str]]) -> list[str]:
    """Return what a rule finds in all files, each with the file's name."""
    return [f"{named(path)}: {found}" for path in FILES for found in of_file(path)]


def length_of_file(path: Path) -> list[str]:
    counts_all = PACKAGE in path.parents or SOURCES not in path.parents
    lines = len(text_of(path).splitlines()) if counts_all else code_lines(text_of(path))
    return [f"{lines} lines"] if lines > FILE_LINES else []


def long_functions(path: Path) -> list[str]:
    lengths = ((item.name, length_without_docstring(item)) for item in functions(path))
    return [f"{name} has {lines} lines" for name, lines in lengths if lines > FUNCTION_LINES]


def wide_functions(path: Path) -> list[str]:
    return [
        f"{item.name} takes {len(parameters(item))} parameters"
        for item in functions(path)
        if len(parameters(item)) > PARAMETERS and not is_kernel(item)
    ]


def test_files_are_short() -> None:
    assert complaints(length_of_file) == []


def test_functions_are_short() -> None:
    assert complaints(long_functions) == []


def test_functions_take_few_parameters() -> None:
    assert complaints(wide_functions) == []


def test_folders_hold_few_files() -> None:
    files = Counter(str(path.parent.relative_to(SOURCES)) for path in FILES)
    assert {folder: count for folder, count in files.items() if count > FOLDER_FILES} == {}


def test_nothing_is_pickled() -> None:
    text = {named(path): text_of(path) for path in FILES}
    assert [name for name, source in text.items() if "import pickle" in source] == []
    assert [name for name, source in text.items() if "allow_pickle=True" in source] == []
