"""The examples: numbered without a gap, short, and on public names only."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import spikingtac

PROJECT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((PROJECT / "examples").glob("*.py"))
MOST_LINES = 80
FOREIGN = {"numpy", "matplotlib"}


def test_they_go_from_01_to_11() -> None:
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02}_" for number in range(1, 12)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_says_how_it_is_run(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    assert f"Run: python examples/{path.name}" in (ast.get_docstring(ast.parse(text)) or "")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_uses_public_names_only(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            assert (node.module or "").split(".")[0] not in {"spikingtac", *FOREIGN}, node.module
        elif isinstance(node, ast.Import):
            assert not [name.name for name in node.names if name.name.startswith("spikingtac.")]
    used = set(re.findall(r"\bst\.(\w+)", text))
    assert used
    assert used <= set(spikingtac.__all__)
