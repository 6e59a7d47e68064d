"""The packages' files, read and parsed once in a process for all tests that look into them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[2] / "src"
PACKAGE = SOURCES / "spikingtac"
FILES = tuple(sorted(SOURCES.rglob("*.py")))


@cache
def text_of(path: Path) -> str:
    """Return the text of a file."""
    return path.read_text(encoding="utf-8")


@cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file; not to be changed."""
    return ast.parse(text_of(path))
