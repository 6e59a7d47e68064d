"""What RAW words are: the text header of Prophesee's files, and which encoding bytes look like."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from spikingtac.events.evt import wire

ENCODINGS = ("evt2", "evt21", "evt3")
LINE_LIMIT = 4096  # Longest header line that is believed, bytes.

HEADER_LIMIT_BYTES = 1 << 20  # Longest header that is read; those of cameras have a kilobyte.

GENERATOR = "spikingtac"
_VERSIONS = {"2.0": "evt2", "2.1": "evt21", "3.0": "evt3"}
_BYTE_ORDERS = ("little", "big", "legacy")


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
    def generated_here(self) -> bool:
        """Whether this package wrote the file, so that time words follow without holes."""
        return self.fields.get("generator", "").startswith(GENERATOR)


def read_header(file: BinaryIO) -> RawHeader:
    """Read the header lines and leave the file at the first word (a header may be missing)."""
    fields: dict[str, str] = {}
    first = file.tell()
    while (start := file.tell()) - first < HEADER_LIMIT_BYTES:
        line = file.readline(LINE_LIMIT)
        if not _is_header_line(line):
            file.seek(start)
            break
        key, _, value = line[1:].decode("latin-1").strip().partition(" ")
        if key == "end":
            break
        fields[key] = value.strip()
    return _understood(fields, file.tell())


def format_header(encoding: str, size: tuple[int, int], time_base_us: int = 0) -> bytes:
    """Return the header that this package writes; nothing in it depends on the clock."""
    version = next(key for key, name in _VERSIONS.items() if name == encoding)
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


def _is_header_line(line: bytes) -> bool:
    if not (line.startswith(b"%") and line.endswith(b"\n")):
        return False
    return all(byte >= 0x20 or byte in b"\t\r\n" for byte in line) and 0x7F not in line


def _understood(fields: dict[str, str], length: int) -> RawHeader:
    name, *options = fields.get("format", "").split(";")
    settings = {key.lower(): value for key, _, value in (item.partition("=") for item in options)}
    plain = name.strip().lower().removesuffix(".0").replace(".", "")
    encoding = plain if plain in ENCODINGS else _VERSIONS.get(fields.get("evt", ""))
    order = (settings.get("endianness") or fields.get("endianness") or "").lower()
    return RawHeader(
        encoding=encoding,
        size=_size({key.lower(): value for key, value in fields.items()}, settings),
        byte_order=order if order in _BYTE_ORDERS else None,
        time_base_us=_number(fields.get("time_base_us")) or 0,
        fields=fields,
        length=length,
    )


def _size(fields: dict[str, str], settings: dict[str, str]) -> tuple[int, int] | None:
    geometry = re.fullmatch(r"(\d+)\s*x\s*(\d+)", fields.get("geometry", ""))
    for pair in (
        (settings.get("width"), settings.get("height")),
        geometry.groups() if geometry else (None, None),
        (fields.get("width"), fields.get("height")),
    ):
        width, height = map(_number, pair)
        if width and height and max(width, height) <= 1 << 11:
            return width, height
    return None


def _number(text: str | None) -> int | None:
    text = (text or "").strip()
    return int(text) if text.isascii() and text.isdigit() and len(text) < 19 else None


CANDIDATES = ("evt3", "evt2", "evt21/little", "evt21/legacy", "evt21/big")
FOREIGN_SHARE = 0.15  # Share of implausible words from which on a claimed format is doubted.

SOUND_SHARE = 0.04  # Share of implausible words up to which another format is believed instead.


def implausible_share(data: bytes, candidate: str, size: tuple[int, int] | None) -> float:
    """Return the share of implausible words, 1 where no evidence supports the candidate."""
    size = size or (1 << 11, 1 << 11)
    encoding, _, order = candidate.partition("/")
    if encoding == "evt3":
        words = np.frombuffer(data, "<u2", len(data) // 2)
        return wire.implausible_share(wire.view_evt3(words, size), wire.EVT3)
    if encoding == "evt2":
        heads, masks = np.frombuffer(data, "<u4", len(data) // 4), None
    else:
        halves = np.frombuffer(data, ">u4" if order == "big" else "<u4", len(data) // 8 * 2)
        head = 1 if order == "little" else 0
        heads, masks = halves[head::2], halves[1 - head :: 2]
    return wire.implausible_share(wire.view_evt2(heads, masks, size), wire.EVT2)


def best_candidate(
    data: bytes, size: tuple[int, int] | None, candidates: tuple[str, ...] = CANDIDATES
) -> tuple[str, float]:
    """Return the candidate with the least implausible share, and that share."""
    shares = {name: implausible_share(data, name, size) for name in candidates}
    name = min(shares, key=lambda key: shares[key])
    return name, shares[name]
