"""Write the tutorial as a Jupyter notebook; a test compares it with the page.

python scripts/tutorial_notebook.py

The page is the one text of both: its Python blocks become cells of code, its commands cells of a
shell, all else cells of Markdown. Outputs are left out, so that a change of the notebook is a
change of its text. The format is nbformat 4.5; nothing is needed to write it.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorial" / "first-figure.md"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```\n?", re.S | re.M)
SAVED = re.compile(r"^(\w+)\.savefig\(", re.M)

# The line by which the page leads to the notebook; the notebook leads nowhere by it.
PAIR = re.compile(r"\n.*\(first-figure\.ipynb\).*\n", re.M)


def notebook(page: str) -> dict[str, Any]:
    """Return the notebook of a page in Markdown, as nbformat 4.5 writes it in JSON."""
    cells = [_cell(kind, text, number) for number, (kind, text) in enumerate(_parts(page))]
    return {
        "cells": cells,
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def text_of(page: str) -> str:
    """Return the file of a page's notebook."""
    return json.dumps(notebook(page), indent=1, ensure_ascii=False) + "\n"


def _parts(page: str) -> Iterator[tuple[str, str]]:
    """Yield kind and text of each cell, in the page's order."""
    page, at = PAIR.sub("\n", page), 0
    for fence in FENCE.finditer(page):
        if before := page[at : fence.start()].strip():
            yield "markdown", before
        language, text = fence.groups()
        yield "code", _shown(text.strip()) if language == "python" else _commands(text)
        at = fence.end()
    if after := page[at:].strip():
        yield "markdown", after


def _shown(code: str) -> str:
    """Return a cell that ends with the figure that it saves: a notebook shows it."""
    saved = SAVED.findall(code)
    return f"{code}\n{saved[-1]}" if saved else code


def _commands(text: str) -> str:
    return "\n".join(f"!{line}" for line in text.strip().splitlines())


def _cell(kind: str, text: str, number: int) -> dict[str, Any]:
    cell = {
        "cell_type": kind,
        "id": f"cell-{number}",
        "metadata": {},
        "source": text.splitlines(keepends=True),
    }
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


if __name__ == "__main__":
    PAGE.with_suffix(".ipynb").write_text(text_of(PAGE.read_text("utf-8")), encoding="utf-8")
