"""The rule of docs/explanation/architecture.md by which an error is chosen."""

import ast
import inspect
from pathlib import Path

from spikingtac import errors
from stand_ins.source_trees import FILES, SOURCES, tree_of

OURS = {name for name, _ in inspect.getmembers(errors, inspect.isclass) if name.endswith("Error")}

# What a wrong use of code raises.
ARGUMENTS = {"ValueError", "TypeError", "AttributeError", "NotImplementedError"}

# Errors of one room: they descend from those of ``errors``, or its callers turn them into one.
WITHIN = {
    "CommandError": "viewer/server.py",
    "DamagedPieceError": "events/formats/pieces.py",
    "_MisfitError": "robot/adaptive_search.py",
}

# What stands for the operating system, a map, or a fault of this package.
SYSTEM = {
    "EOFError", "OSError", "TimeoutError", "ConnectionResetError", "KeyError", "RuntimeError",
}  # fmt: skip


def raised(path: Path) -> set[str]:
    """Return the names of the classes that a file raises; re-raised variables are left out."""
    calls = [node.exc for node in ast.walk(tree_of(path)) if isinstance(node, ast.Raise)]
    named = [call.func if isinstance(call, ast.Call) else call for call in calls]
    return {name.id for name in named if isinstance(name, ast.Name) and name.id.endswith("Error")}


def test_every_error_is_one_of_the_rule() -> None:
    allowed = {*OURS, *ARGUMENTS, *SYSTEM, *WITHIN}
    found = {str(path.relative_to(SOURCES)): raised(path) - allowed for path in FILES}
    assert {name: wrong for name, wrong in found.items() if wrong} == {}


def test_errors_are_defined_in_one_place() -> None:
    defined = {
        node.name: str(path.relative_to(SOURCES / "spikingtac"))
        for path in FILES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ClassDef) and node.name.endswith("Error")
    }
    assert {name: where for name, where in defined.items() if where != "errors.py"} == WITHIN
