"""The tutorial's notebook is its page: the same text, the same code, no outputs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

from stand_ins.pasted import cells, pieces
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


def test_it_runs_what_the_page_runs() -> None:
    on_page = [piece.strip() for _, piece in pieces(PAGE.read_text("utf-8"))]
    in_cells = [piece.strip() for _, piece in cells(NOTEBOOK.read_text("utf-8"))]
    assert len(on_page) >= 10
    shown = [piece.removesuffix("\nfigure") for piece in in_cells]
    assert shown == on_page
    assert sum(piece != both for piece, both in zip(in_cells, shown, strict=True)) == 2


def test_it_is_a_notebook() -> None:
    document = json.loads(NOTEBOOK.read_text("utf-8"))
    assert (document["nbformat"], document["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in document["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in document["cells"]:
        assert re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", cell["id"])
        assert all(isinstance(line, str) for line in cell["source"])
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
        else:
            assert set(cell) == {"cell_type", "id", "metadata", "source"}


def test_jupyter_s_own_check_passes() -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbformat.validate(json.loads(NOTEBOOK.read_text("utf-8")))


def test_its_links_lead_to_files() -> None:
    text = NOTEBOOK.read_text("utf-8")
    links = re.findall(r"\]\(([^)#:\s]+)", text)
    assert len(links) > 3
    assert [link for link in links if not (NOTEBOOK.parent / link).exists()] == []
