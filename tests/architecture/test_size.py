"""The ratchet: how large the packages may be. The figures only fall."""

import ast
import re
from dataclasses import astuple, dataclass
from pathlib import Path

import pytest

from stand_ins.source_trees import FILES, SOURCES, code_lines, tree_of

PROJECT = SOURCES.parent


@dataclass(frozen=True)
class Size:
    """Files, lines that hold code (no blank lines, comments, docstrings), and statements."""

    files: int
    code_lines: int
    statements: int


# Folder -> what it may hold.
MOST = {
    "src/spikingtac": Size(245, 26_287, 24_190),
    "src/spikingtac_paper": Size(60, 5_878, 4_800),
    "src/spikingtac_hardware": Size(11, 1_242, 1_163),
    "integrations": Size(23, 1_664, 1_577),
    "tests": Size(210, 19_943, 17_507),
    "benchmarks": Size(4, 886, 699),
}


def size_of(folder: Path) -> Size:
    files = lines = statements = 0
    for path in folder.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        files += 1
        lines += code_lines(text)
        statements += sum(isinstance(node, ast.stmt) for node in ast.walk(tree))
    return Size(files, lines, statements)


@pytest.mark.parametrize("folder", MOST)
def test_a_package_does_not_grow(folder: str) -> None:
    found, most = size_of(PROJECT / folder), MOST[folder]
    over = [n > m for n, m in zip(astuple(found), astuple(most), strict=True)]
    assert not any(over), f"{folder} has {found}, at most {most}: remove something first"


def test_settings_do_not_grow() -> None:
    """Counts the fields of all that settings files, scenes and options fill in."""
    bodies = "Compliant|Ellipsoid|Punch|Rods|SoftLayer"
    of_settings = re.compile(rf"Config$|^(Scene|CameraChoice|{bodies})$")
    nodes = [node for path in FILES for node in ast.walk(tree_of(path))]
    found = [
        node for node in nodes if isinstance(node, ast.ClassDef) and of_settings.search(node.name)
    ]
    assert sum(isinstance(line, ast.AnnAssign) for node in found for line in node.body) <= 148
