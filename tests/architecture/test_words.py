"""User-facing text: short sentences, and the field's words instead of private ones.

The pages of the command line and of Python are made from help texts and docstrings, so these are
checked as well.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PAGES = [
    PROJECT / "README.md",
    PROJECT / "CHANGELOG.md",
    *sorted((PROJECT / "docs").rglob("*.md")),
]
MOST_WORDS = 30

# Former private words: hysteresis of pixels, leak, direction of motion, observation.
RETIRED = re.compile(
    r"\b(eas(?:ed|ing) outlines?|backlash|ground returns?|turn votes?|desk|sightings?|custody)\b",
    re.I,
)
CODE = re.compile(r"^```.*?^```|^ {4,}\S[^\n]*$|^#[^\n]*$", re.S | re.M)
NEW_ITEM = re.compile(r"\n(?=\s*(?:[-*]|\d+\.) )")
END = re.compile(r"(?<=[.!?;])\s+(?=[A-Z`*\[(\d])|(?<=:)\s+(?=[A-Z`])")


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page in Markdown: of its paragraphs, list items and cells."""
    for block in re.split(r"\n\s*\n", CODE.sub("", text)):
        if block.lstrip().startswith("|"):
            # Cells hold lists, whose items semicolons separate.
            pieces = [item for row in block.splitlines() for item in re.split(r" \| |; ", row)]
        else:
            pieces = NEW_ITEM.split(block)
        for piece in pieces:
            plain = re.sub(r"`[^`]*`", "CODE", re.sub(r"\]\([^)]*\)", "]", piece))
            yield from END.split(" ".join(plain.split()))


def words(sentence: str) -> int:
    return len([word for word in sentence.split() if re.search(r"\w", word)])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(PROJECT)))
def test_sentences_are_short_and_words_are_the_fields(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [line for line in sentences(text) if words(line) > MOST_WORDS] == []
    assert [hit.group() for hit in RETIRED.finditer(text)] == []
