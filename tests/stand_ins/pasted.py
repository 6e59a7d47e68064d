"""The blocks of a page, or the cells of a notebook, as a reader runs them, in their order."""

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from spikingtac.cli.main import main

FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.S | re.M)
SHOWN = ("view", "demo")  # Verbs that show a page until they are ended.
SHORT = "--seconds", "1"  # What such verbs show here, and what they export.

# Scene -> what is simulated here: all slides, and a finger that turned both ways.
SHORTER = {"bootstrap": (), "finger-torsion": ("--duration-s", "4.2")}


def pieces(page: str) -> Iterator[tuple[str, str]]:
    """Yield ``("command", line)`` for each command of this package, ``("python", block)``."""
    for language, text in FENCE.findall(page):
        if language == "python":
            yield "python", text
        elif language in ("", "sh"):
            lines = (line.partition(" #")[0].strip() for line in text.splitlines())
            yield from (("command", line) for line in lines if line.startswith("spikingtac "))


def cells(notebook: str) -> Iterator[tuple[str, str]]:
    """Yield the same of a notebook: lines that begin with ``!`` are commands."""
    for cell in json.loads(notebook)["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "code" and text.startswith("!"):
            yield from (("command", line.removeprefix("!")) for line in text.splitlines())
        elif cell["cell_type"] == "code":
            yield "python", text


def paste(page: Path, begin: str = "", ready: Collection[str] = ()) -> int:
    """Run a page in the current folder and return how many pieces ran.

    Args:
        page: The page, or the notebook.
        begin: Where on the page to begin.
        ready: Outputs that are there already; the commands that would make them are left out.

    Raises:
        AssertionError: A command failed, or a block asserts in vain.
    """
    text, names = page.read_text(encoding="utf-8"), dict[str, Any](__name__="pasted")
    ran = 0
    found = cells(text) if page.suffix == ".ipynb" else pieces(text[text.index(begin) :])
    for kind, piece in found:
        if kind == "python":
            exec(compile(piece, page.name, "exec"), names)
        else:
            _, verb, *rest = shlex.split(piece)
            if "-o" in rest and rest[rest.index("-o") + 1] in ready:
                continue
            if verb in SHOWN:
                rest += SHORT if "--export" in rest else ("--headless", *SHORT, "--port", "0")
            elif verb == "simulate":
                rest += SHORTER[rest[0]]
            if any(word.startswith("twin:") for word in rest):  # the scene of a camera's process
                subprocess.run([sys.executable, "-m", "spikingtac", verb, *rest], check=True)
            else:
                assert main([verb, *rest]) == 0, piece
        ran += 1
    return ran
