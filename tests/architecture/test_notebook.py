"""The tutorial's notebook is its page: the same text, the same code, no outputs."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import pytest

from stand_ins.programs import program

PROJECT = Path(__file__).resolve().parents[2]
PAGE = PROJECT / "docs" / "tutorial" / "first-figure.md"
NOTEBOOK = PAGE.with_suffix(".ipynb")


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return program("scripts/tutorial_notebook.py")


def test_it_is_made_from_the_page(script: ModuleType) -> None:
    expected = script.text_of(PAGE.read_text("utf-8"))
    assert NOTEBOOK.read_text("utf-8") == expected, "run: python scripts/tutorial_notebook.py"


def test_jupyter_s_own_check_passes() -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbformat.validate(json.loads(NOTEBOOK.read_text("utf-8")))
