"""Prophesee RAW files: a text header, then words of EVT2, EVT2.1 or EVT3."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from spikingtac.errors import FormatError, named
from spikingtac.events.evt import wire
from spikingtac.events.formats.file_source import FileSource, ReadOptions, Rows

CHUNK_BYTES = 1 << 18  # Bytes that are decoded at once.
SAMPLE_BYTES = 1 << 16  # Bytes that are judged before the first one is decoded.
LINE_LIMIT = 4096  # Longest header line that is believed, bytes.
HEADER_LIMIT_BYTES = 1 << 20  # Longest header that is read; those of cameras have a kilobyte.
GENERATOR = "spikingtac"
_PRINTABLE = re.compile(rb"[\t\r\x20-\x7e\x80-\xff]*\n")
VERSIONS = {"2.0": "evt2", "2.1": "evt21", "3.0": "evt3"}  # What the line ``evt`` says.


@dataclass(frozen=True, kw_only=True)
class RawHeader:
    """What the header of a RAW file names; None where it is silent.

    Attributes:
        encoding: ``evt2``, ``evt21`` or ``evt3``.
        size: ``(width, height)``, px.
        byte_order: Of EVT 2.1 words: ``little`` (64 bits at once), ``legacy`` (the upper half
            first, each half little-endian) or ``big``.
        time_base_us: Added to the wire's time; whole periods of its counter.
        fields: Every line, key to value.
        length: Bytes before the first word.
    """

    encoding: str | None = None
    size: tuple[int, int] | None = None
    byte_order: str | None = None
    time_base_us: int = 0
    fields: dict[str, str] = field(default_factory=dict)
    length: int = 0

    @property
    def continuous(self) -> bool:
        """Whether this package wrote EVT3: its time words follow without holes."""
        return self.encoding == "evt3" and self.fields.get("generator", "").startswith(GENERATOR)


def header_lines(file: BinaryIO, mark: bytes) -> Iterator[str]:
    """Yield the lines of text behind a mark; words may begin with the mark's byte as well."""
    first = file.tell()
    while (start := file.tell()) - first < HEADER_LIMIT_BYTES:
        line = file.readline(LINE_LIMIT)
        if not (line.startswith(mark) and _PRINTABLE.fullmatch(line)):
            file.seek(start)
            return
        yield line.decode("latin-1")


def read_header(file: BinaryIO) -> RawHeader:
    """Read the header lines and leave the file at the first word (a header may be missing)."""
    fields: dict[str, str] = {}
    for line in header_lines(file, b"%"):
        key, _, value = line[1:].strip().partition(" ")
        if key == "end":
            break
        fields[key] = value.strip()
    name, *options = fields.get("format", "").split(";")
    settings = {key.lower(): value for key, _, value in (item.partition("=") for item in options)}
    plain = name.strip().lower().removesuffix(".0").replace(".", "")
    order = (settings.get("endianness") or fields.get("endianness") or "").lower()
    return RawHeader(
        encoding=plain if plain in wire.ENCODINGS else VERSIONS.get(fields.get("evt", "")),
        size=_size({key.lower(): value for key, value in fields.items()}, settings),
        byte_order=order if order in wire.BYTE_ORDERS else None,
        time_base_us=_number(fields.get("time_base_us")),
        fields=fields,
        length=file.tell(),
    )


def _size(fields: dict[str, str], settings: dict[str, str]) -> tuple[int, int] | None:
    for pair in (
        (settings.get("width"), settings.get("height")),
        fields.get("geometry", "").lower().partition("x")[::2],
        (fields.get("width"), fields.get("height")),
    ):
        width, height = map(_number, pair)
        if width and height and max(width, height) <= wire.WIDEST_PX:
            return width, height
    return None


def _number(text: str | None) -> int:
    """Return a whole number, or 0 where there is none."""
    text = (text or "").strip()
    return int(text) if text.isascii() and text.isdigit() and len(text) < 19 else 0


def format_header(encoding: str, size: tuple[int, int], time_base_us: int = 0) -> bytes:
    """Return the header that this package writes; nothing in it depends on the clock."""
    version = next(key for key, name in VERSIONS.items() if name == encoding)
    width, height = size
    order = ";endianness=little" if encoding == "evt21" else ""
    lines = [
        f"evt {version}",
        f"format {encoding.upper()};width={width};height={height}{order}",
        f"geometry {width}x{height}",
        f"generator {GENERATOR}",
        # Metavision picks the plug-in that decodes a file by this pair of names.
        "integrator_name Prophesee",
        "plugin_name hal_plugin_prophesee",
    ]
    if encoding == "evt21":
        lines.append("endianness little")
    if time_base_us:
        lines.append(f"time_base_us {time_base_us}")
    return "".join(f"% {line}\n" for line in [*lines, "end"]).encode("ascii")


class _Part(NamedTuple):
    """One file of a recording: its header, and its encoding with the byte order of EVT2.1."""

    path: Path
    header: RawHeader
    candidate: str


class RawSource(FileSource):
    """Events of a RAW file, or of several that follow each other; damage is mended and counted.

    Args:
        path: The file, or the first one.
        options: How it is read.
        others: The files that follow in time, in order.

    Raises:
        ConfigError: ``encoding`` is unknown.
        FormatError: The words do not look like the encoding that the header names, and do look
            like another one.
    """

    checked = True

    def __init__(self, path: Path, options: ReadOptions, others: tuple[Path, ...] = ()) -> None:
        if options.encoding is not None:
            named(wire.NAMES, options.encoding, "encoding")
        notes: list[str] = []
        self._parts = [_part(file, options.encoding, notes) for file in (path, *others)]
        encoding = self._parts[0].candidate.partition("/")[0]
        self.format = wire.NAMES[encoding] + (f" in {len(self._parts)} parts" if others else "")
        self._named_size = self._parts[0].header.size
        super().__init__(path, options)
        self.notes.extend(notes)

    def _columns(self) -> Iterator[Rows]:
        from spikingtac.events.evt.words import WordStream

        for number, (path, header, name) in enumerate(self._parts):
            into = self.losses, self.triggers
            stream = WordStream(name, self.size, *into, header.time_base_us, header.continuous)
            total = max(path.stat().st_size, 1)
            with path.open("rb") as file:
                file.seek(header.length)
                data = file.read(CHUNK_BYTES)
                while data:
                    following = file.read(CHUNK_BYTES)
                    self.progress = (number + file.tell() / total) / len(self._parts)
                    yield stream.feed(data, final=not following)
                    data = following


def _part(path: Path, encoding: str | None, notes: list[str]) -> _Part:
    """Return a file with its encoding, from what is asked for, the header, or the first words."""
    with path.open("rb") as file:
        header = read_header(file)
        sample = file.read(SAMPLE_BYTES)
    claimed, names = encoding or header.encoding, wire.CANDIDATES
    if claimed is not None:
        orders = (header.byte_order,) if header.byte_order else wire.BYTE_ORDERS
        names = tuple(f"evt21/{order}" for order in orders) if claimed == "evt21" else (claimed,)
    if not sample:
        if claimed is None:
            notes.append("the file holds no events")
        return _Part(path, header, names[0])
    name, share = wire.best_candidate(sample, header.size, names)
    if claimed == "evt21" and not header.byte_order:
        notes.append(f"the header names no byte order; {name.partition('/')[2]} fits")
    if share > wire.SOUND_SHARE and claimed is None:
        raise FormatError(
            f"{str(path)!r} names no encoding that is read, and its words fit none of "
            f"{', '.join(wire.NAMES.values())}; name one if you know it (--encoding, in Python "
            "encoding=), or export the recording again with the software of its camera"
        )
    if claimed is None:
        notes.append(f"the header names no encoding; {wire.NAMES[name.partition('/')[0]]} fits")
    elif share > wire.FOREIGN_SHARE and encoding is None:
        found, other_share = wire.best_candidate(sample, header.size)
        if found != name and other_share <= wire.SOUND_SHARE:
            raise FormatError(
                f"{str(path)!r}: the header says {_spoken(name)}, but the words are "
                f"{_spoken(found)} ({share:.0%} of them make no sense as {_spoken(name)}); correct "
                "the header's '% evt' and '% format' lines, or read it with "
                f"--encoding {found.partition('/')[0]} (in Python encoding=)"
            )
    return _Part(path, header, name)


def _spoken(candidate: str) -> str:
    encoding, _, order = candidate.partition("/")
    return wire.NAMES[encoding] + (f" ({order} byte order)" if order else "")


def part_name(first: str, number: int) -> str:
    """Return the name of a part: ``events.raw``, ``events.0001.raw``, ``events.0002.raw`` ...

    Args:
        first: Name of the first part.
        number: Which one, from 0 on.
    """
    stem, dot, ending = first.rpartition(".")
    return first if number == 0 else f"{stem}.{number:04d}{dot}{ending}"


def later_parts(first: Path) -> tuple[Path, ...]:
    """Return the parts of a recording behind its first one, in order; empty files are left out."""
    stem, _, ending = first.name.rpartition(".")
    named = first.parent.glob(f"{stem}.[0-9][0-9][0-9][0-9]*.{ending}")
    numbers = {path: path.stem.rpartition(".")[2] for path in named if path.stat().st_size}
    later = [path for path, number in numbers.items() if number.isdecimal()]
    return tuple(sorted(later, key=lambda path: int(numbers[path])))
