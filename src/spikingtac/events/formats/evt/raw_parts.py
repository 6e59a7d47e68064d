"""A recording that was split into several RAW files, read as one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from spikingtac.events.formats.evt.raw import RawSource
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

PART_DIGITS = 4


def part_name(first: str, number: int) -> str:
    """Return the name of a part: ``events.raw``, ``events.0001.raw``, ``events.0002.raw`` ...

    Args:
        first: Name of the first part.
        number: Which one, from 0 on.
    """
    stem, dot, ending = first.rpartition(".")
    return first if number == 0 else f"{stem}.{number:0{PART_DIGITS}d}{dot}{ending}"


def parts_of(first: Path) -> list[Path]:
    """Return the parts of a recording that are there, in order; those without a word are left out.

    Args:
        first: Path of the first part.
    """
    stem, _, ending = first.name.rpartition(".")
    digits = "[0-9]" * PART_DIGITS
    later = sorted(first.parent.glob(f"{stem}.{digits}*.{ending}"), key=_number)
    return [first, *(path for path in later if path.stat().st_size)]


class RawParts(FileSource):
    """Events of several RAW files of one sensor that follow each other in time.

    Args:
        parts: The files, in order; at least one.
        options: As of a file.

    Raises:
        FormatError: A part does not fit its header.
    """

    checked = True

    def __init__(self, parts: list[Path], options: ReadOptions) -> None:
        self._sources = [RawSource(path, options) for path in parts]
        super().__init__(parts[0], options)
        self.format = f"{self._sources[0].format} in {len(parts)} parts"
        self.notes.extend(note for source in self._sources for note in source.notes)

    def _size(self) -> tuple[int, int]:
        return self._sources[0].size

    def _columns(self) -> Iterator[Rows]:
        first = 0 if self.begin is None else self.begin.part
        for number, source in enumerate(self._sources[first:], start=first):
            source.losses, source.triggers = self.losses, self.triggers
            source.begin = self.begin if number == first else None
            for rows in source.columns():
                self.progress = (number + source.progress) / len(self._sources)
                self.place = source.place and replace(source.place, part=number)
                yield rows


def _number(path: Path) -> int:
    digits = path.stem.rpartition(".")[2]
    return int(digits) if digits.isdecimal() else -1
