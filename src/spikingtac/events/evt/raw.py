"""Prophesee RAW files: a text header, then words of EVT2, EVT2.1 or EVT3."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from spikingtac.errors import ConfigError, FormatError, nearest
from spikingtac.events.evt.header import (
    ENCODINGS,
    FOREIGN_SHARE,
    SOUND_SHARE,
    RawHeader,
    best_candidate,
    implausible_share,
    read_header,
)
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

CHUNK_BYTES = 1 << 18  # Bytes that are decoded at once.

SAMPLE_BYTES = 1 << 16  # Bytes that are judged before the first one is decoded.

NAMES = {"evt2": "EVT2", "evt21": "EVT2.1", "evt3": "EVT3"}


class RawSource(FileSource):
    """Events of a RAW file; damage is mended and counted.

    Raises:
        ConfigError: ``encoding`` is unknown.
        FormatError: The words do not look like the encoding that the header names, and do look
            like another one.
    """

    checked = True

    def __init__(self, path: Path, options: ReadOptions) -> None:
        if options.encoding is not None and options.encoding not in ENCODINGS:
            raise ConfigError(
                f"unknown encoding {options.encoding!r}{nearest(options.encoding, ENCODINGS)} "
                f"(valid: {', '.join(ENCODINGS)})"
            )
        with path.open("rb") as file:
            self.header = read_header(file)
            sample = file.read(SAMPLE_BYTES)
        self._notes: list[str] = []
        self._encoding, self._byte_order = self._dispatched(path, sample, options)
        self.format = NAMES[self._encoding]
        super().__init__(path, options)
        self.notes.extend(self._notes)

    def _size(self) -> tuple[int, int]:
        return self.header.size or self._size_from_events()

    def _columns(self) -> Iterator[Rows]:
        from spikingtac.events.evt.words import WordDecoder, WordStream

        continuous = self._encoding == "evt3" and self.header.generated_here
        decoder = WordDecoder(self._encoding, self.size, self._byte_order, continuous)
        stream = WordStream(decoder, self.losses, self.triggers, self.header.time_base_us)
        total = max(self.path.stat().st_size, 1)
        with self.path.open("rb") as file:
            file.seek(self.header.length)
            data = file.read(CHUNK_BYTES)
            while data:
                following = file.read(CHUNK_BYTES)
                self.progress = file.tell() / total
                yield stream.feed(data, final=not following)
                data = following

    def _dispatched(self, path: Path, sample: bytes, options: ReadOptions) -> tuple[str, str]:
        """Return encoding and byte order, from the header or else from the first words."""
        header = self.header
        claimed = options.encoding or header.encoding
        if claimed is None:
            return self._guessed(path, sample)
        orders = [header.byte_order] if header.byte_order else ["little", "legacy"]
        names = tuple(f"evt21/{order}" for order in orders) if claimed == "evt21" else (claimed,)
        if not sample:
            return claimed, orders[0]
        name, share = best_candidate(sample, header.size, names)
        if claimed == "evt21" and not header.byte_order:
            self._notes.append(f"the header names no byte order; {name.partition('/')[2]} fits")
        if options.encoding is None and share > FOREIGN_SHARE:
            _refuse_foreign(path, sample, header, name)
        return claimed, name.partition("/")[2] or "little"

    def _guessed(self, path: Path, sample: bytes) -> tuple[str, str]:
        if not sample:
            self._notes.append("the file holds no events")
            return "evt3", "little"
        name, share = best_candidate(sample, self.header.size)
        if share > FOREIGN_SHARE:
            raise FormatError(
                f"{str(path)!r} names no encoding in its header, and its words fit none of "
                f"{', '.join(NAMES.values())}; name one if you know it (--encoding, in Python "
                "encoding=), or export the recording again with the software of its camera"
            )
        encoding, _, order = name.partition("/")
        self._notes.append(f"the header names no encoding; {NAMES[encoding]} fits")
        return encoding, order or "little"


def _refuse_foreign(path: Path, sample: bytes, header: RawHeader, claimed: str) -> None:
    found, share = best_candidate(sample, header.size)
    if found == claimed or share > SOUND_SHARE:
        return
    doubt = implausible_share(sample, claimed, header.size)
    raise FormatError(
        f"{str(path)!r}: the header says {_spoken(claimed)}, but the words are {_spoken(found)} "
        f"({doubt:.0%} of them make no sense as {_spoken(claimed)}); correct the header's "
        f"'% evt' and '% format' lines, or read it with "
        f"--encoding {found.partition('/')[0]} (in Python encoding=)"
    )


def _spoken(candidate: str) -> str:
    encoding, _, order = candidate.partition("/")
    return NAMES[encoding] + (f" ({order} byte order)" if order else "")


def part_name(first: str, number: int) -> str:
    """Return the name of a part: ``events.raw``, ``events.0001.raw``, ``events.0002.raw`` ...

    Args:
        first: Name of the first part.
        number: Which one, from 0 on.
    """
    stem, dot, ending = first.rpartition(".")
    return first if number == 0 else f"{stem}.{number:04d}{dot}{ending}"


def parts_of(first: Path) -> list[Path]:
    """Return the parts of a recording that are there, in order; those without a word are left out.

    Args:
        first: Path of the first part.
    """
    stem, _, ending = first.name.rpartition(".")
    named = first.parent.glob(f"{stem}.[0-9][0-9][0-9][0-9]*.{ending}")
    numbers = {path: path.stem.rpartition(".")[2] for path in named if path.stat().st_size}
    later = [path for path, number in numbers.items() if number.isdecimal()]
    return [first, *sorted(later, key=lambda path: int(numbers[path]))]


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
        for number, source in enumerate(self._sources):
            source.losses, source.triggers = self.losses, self.triggers
            for rows in source.columns():
                self.progress = (number + source.progress) / len(self._sources)
                yield rows
