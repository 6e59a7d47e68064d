"""The experiments and the hardware use public names of the product: one level below it at most."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from types import ModuleType

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "src"
USERS = ("spikingtac_paper", "spikingtac_hardware")
ROOMS = sorted(path.parent.name for path in SOURCES.glob("spikingtac/*/__init__.pyi"))


def deep_imports(text: str) -> list[str]:
    """Return the imports of a module that reach deeper than a room."""
    found = [
        node.module
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and node.module
    ]
    return [name for name in found if name.startswith("spikingtac.") and name.count(".") > 1]


def test_a_deep_import_is_noticed() -> None:
    text = "from spikingtac.sim import Gel\nfrom spikingtac.sim.gel import Gel\n"
    assert deep_imports(text) == ["spikingtac.sim.gel"]


@pytest.mark.parametrize("package", USERS)
def test_no_import_reaches_deeper_than_a_room(package: str) -> None:
    deep = {
        str(path.relative_to(SOURCES)): found
        for path in sorted((SOURCES / package).rglob("*.py"))
        if (found := deep_imports(path.read_text(encoding="utf-8")))
    }
    assert deep == {}


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_of_a_room_is_there(room: str) -> None:
    module = importlib.import_module(f"spikingtac.{room}")
    named = [getattr(module, name) for name in module.__all__]
    assert named
    assert not any(isinstance(found, ModuleType) for found in named)
