"""Every picture of the documentation says how it is made, by a command that exists."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from spikingtac.cli.main import function_of, verbs

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [
    PROJECT / "README.md",
    PROJECT / "hardware" / "README.md",
    *sorted((PROJECT / "docs").rglob("*.md")),
]
PICTURE = re.compile(r"!\[[^\]]*\]\(([^)\s]+)\)")
COMMAND = re.compile(r"`((?:spikingtac|python) [^`]+)`", re.S)
NEAR = 900  # Letters before and after a picture in which its command stands.
SCREENSHOTS = {"viewer.png"}  # Pictures of a browser, which no command of this package makes.


def pictures() -> Iterator[tuple[Path, str, str]]:
    """Yield page, picture and the text around it."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for found in PICTURE.finditer(text):
            yield page, found.group(1), text[max(found.start() - NEAR, 0) : found.end() + NEAR]


@pytest.mark.parametrize(
    ("page", "picture", "around"),
    [pytest.param(*found, id=f"{found[0].parent.name}-{found[1]}") for found in pictures()],
)
def test_a_picture_has_a_command(page: Path, picture: str, around: str) -> None:
    path = (page.parent / picture).resolve()
    assert path.is_file()
    if path.name not in SCREENSHOTS:
        assert COMMAND.search(around), f"{page.name} does not say how {picture} is made"


def test_the_commands_exist_with_their_options() -> None:
    from spikingtac.cli.main import _parsed

    commands = {
        " ".join(line.split()) for *_, around in pictures() for line in COMMAND.findall(around)
    }
    assert len(commands) >= 4
    for command in commands:
        program, first, *rest = shlex.split(command)
        if first == "-m":
            assert [*(PROJECT / "integrations").rglob(f"{rest[0]}/__main__.py")], command
            continue
        if program == "python":
            assert (PROJECT / first).is_file(), command
            continue
        assert first in verbs(), command
        if rest:  # a bare verb is a mention, no command
            assert _parsed(function_of(first)[1], first, rest) is not None
