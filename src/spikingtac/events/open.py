"""Open event files, recording folders and cameras: content picks the reader, then ending."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from spikingtac import plugins
from spikingtac.errors import ConfigError, FormatError, RecordingError, nearest
from spikingtac.events.address import Address, is_address
from spikingtac.events.formats.evt.raw_stream import RawStream, is_stream
from spikingtac.events.formats.file_source import CHUNK_EVENTS, FileSource, ReadOptions
from spikingtac.file_kinds import told_kind
from spikingtac.plugins import with_plugins

READABLE = (
    ".raw", ".npz", ".csv", ".txt", ".es", ".dat", ".aedat4", ".h5", ".hdf5",
    ".db3", ".mcap", ".bag",
)  # fmt: skip
"""Endings that can be read."""

FOREIGN = (".pdf", ".png", ".jpg", ".gif", ".svg", ".mp4", ".avi", ".json", ".toml", ".html", ".md")
"""Endings of what is no slip of the pen."""
RECORDING_NAME = "events.raw"
MOST_NAMED = 3
"""Recordings of a folder that an error names."""


class _Opener(Protocol):
    def __call__(self, path: Path, options: ReadOptions) -> FileSource: ...


def open_events(
    path: str | Path,
    *,
    strict: bool = False,
    chunk_events: int = CHUNK_EVENTS,
    sensor: int = 0,
    encoding: str | None = None,
    size: tuple[int, int] | None = None,
) -> FileSource:
    """Open an event file, a recording folder or a camera, for reading in packets.

    Args:
        path: File, or folder with ``events.raw``; a named pipe, or ``-`` for standard input, is
            read as RAW while it comes, once; the address of a camera, as
            ``udp:7777?encoding=evt2&size=320x320``, is read for as long as it sends.
        strict: Raise at the first damage instead of mending and counting it.
        chunk_events: About how many events a packet holds.
        sensor: In a folder, the sensor: 1 opens ``events_1.raw``, on the first sensor's clock.
        encoding: RAW words to assume whatever the header says: evt2, evt21 or evt3.
        size: ``(width, height)`` to assume whatever the file says, px.

    Returns:
        A source that may be iterated again, with ``size``, ``losses``, ``triggers``, ``format`` and
        ``notes`` (what had to be assumed).

    Raises:
        RecordingError: The file is missing or cannot be read; FormatError where its content does
            not fit its header or ending.
        ConfigError: The ending or an argument is unknown.
        MissingExtraError: The format needs a library of the extra ``[formats]``, or the camera one
            of its own.
        DeviceError: There is no such camera, or it refuses.
    """
    if chunk_events < 1:
        raise ConfigError(f"chunk_events is {chunk_events}, it must be at least 1")
    options = ReadOptions(strict=strict, chunk_events=chunk_events, encoding=encoding, size=size)
    if is_address(path):
        from spikingtac.events.cameras.source import CameraSource

        return CameraSource(Address.parse(path), options)
    file = _file(Path(path), sensor)
    if Path(path).is_dir() and file.suffix == ".raw":
        return _of_folder(Path(path), file, sensor, options)
    return _opener(file)(file, options)


def _of_folder(folder: Path, file: Path, sensor: int, options: ReadOptions) -> FileSource:
    """Return the events of one sensor of a folder, all its parts, on the first sensor's clock."""
    from spikingtac.events.clocks.recorded import time_base_of
    from spikingtac.events.clocks.retimed import RetimedSource
    from spikingtac.events.formats.evt.raw_parts import RawParts, parts_of

    parts = parts_of(file)
    source = RawParts(parts, options) if len(parts) > 1 else _opener(file)(file, options)
    time_map = time_base_of(folder, sensor)
    return source if time_map is None else RetimedSource(source, time_map, options)


def _file(path: Path, sensor: int) -> Path:
    if path.is_dir():
        name = RECORDING_NAME if sensor == 0 else f"events_{sensor}.raw"
        if not (path / name).is_file() and not _is_ros2_folder(path):
            raise RecordingError(
                f"the folder {str(path)!r} holds no {name}; a recording folder has events.raw "
                f"(events_1.raw for a second sensor){_named_inside(path)}"
            )
        return path / name if (path / name).is_file() else _ros2_storage(path)
    refuse_url(path)
    if not path.exists() and not is_stream(path):
        raise RecordingError(f"there is no file {str(path)!r}; check the path")
    return path


def first_event_us(path: str | Path) -> int | None:
    """Return the time of a recording's first event, us; None of a camera, which is read once."""
    if is_stream(Path(path)):
        return None
    return next((int(packet.t[0]) for packet in open_events(path) if len(packet)), None)


def refuse_url(path: Path) -> None:
    """Refuse an address on the net.

    Raises:
        RecordingError: The path is one, such as ``https://host/file.raw``.
    """
    scheme, colon, rest = str(path).partition(":/")
    if colon and len(scheme) > 1 and scheme.isalnum() and not path.exists():
        address = f"{scheme}://{rest.lstrip('/')}"  # a path keeps one of its two slashes
        raise RecordingError(f"{address!r} is an address on the net; download it, name the file")


def _is_ros2_folder(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() and bool(_storages(path))


def _storages(path: Path) -> list[Path]:
    return sorted([*path.glob("*.db3"), *path.glob("*.mcap")])


def _ros2_storage(path: Path) -> Path:
    storages = _storages(path)
    if len(storages) > 1:
        raise RecordingError(
            f"{str(path)!r} is a bag of {len(storages)} files; open one of them: "
            + ", ".join(item.name for item in storages)
        )
    return storages[0]


def _opener(path: Path) -> _Opener:
    if is_stream(path):
        return RawStream
    with path.open("rb") as file:
        start = file.read(64)
    if not start:
        raise RecordingError(f"{str(path)!r} is empty (0 bytes): nothing was recorded into it")
    kind = _kind_by_content(start)
    if kind is None:
        foreign, ending = with_plugins({}, plugins.READERS), path.suffix.lower().removeprefix(".")
        if ending in foreign:
            return foreign[ending]
    return _own_opener(kind or _kind_by_ending(path), path)


def _own_opener(kind: str, path: Path) -> _Opener:
    if kind == "raw":
        from spikingtac.events.formats.evt.raw import RawSource as Source
    elif kind == "npz":
        from spikingtac.events.formats.npz import NpzSource as Source
        from spikingtac.events.formats.recorders.openmv_npz import OpenMvNpzSource, is_openmv

        if is_openmv(path):
            return OpenMvNpzSource
    elif kind == "csv":
        from spikingtac.events.formats.csv import CsvSource as Source
    elif kind == "es":
        from spikingtac.events.formats.es import EsSource as Source
    elif kind == "dat":
        from spikingtac.events.formats.dat import DatSource as Source
    elif kind == "aedat4":
        from spikingtac.events.formats.aedat4 import Aedat4Source as Source
    elif kind == "hdf5":
        from spikingtac.events.formats.hdf5 import Hdf5Source as Source
    else:
        from spikingtac.events.formats.bags.source import RosSource as Source
    return Source


_SIGNATURES = (
    (b"PK\x03\x04", "npz"),
    (b"Event Stream", "es"),
    (b"#!AER-DAT4.0", "aedat4"),
    (b"\x89HDF\r\n\x1a\n", "hdf5"),
    (b"SQLite format 3\x00", "ros"),
    (b"\x89MCAP", "ros"),
    (b"#ROSBAG", "ros"),
)
_KINDS = {
    ".raw": "raw", ".npz": "npz", ".csv": "csv", ".txt": "csv", ".es": "es", ".dat": "dat",
    ".aedat4": "aedat4", ".h5": "hdf5", ".hdf5": "hdf5", ".db3": "ros", ".mcap": "ros",
    ".bag": "ros",
}  # fmt: skip


def _named_inside(folder: Path) -> str:
    """Return a hint at the first event files and recording folders in a folder."""
    inside = [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in READABLE or (path / RECORDING_NAME).is_file()
    ]
    if not inside:
        return ""
    more = f", ... ({len(inside)} in all)" if len(inside) > MOST_NAMED else ""
    return f"; it holds {', '.join(map(str, inside[:MOST_NAMED]))}{more}: give one of these"


def _kind_by_content(start: bytes) -> str | None:
    for signature, kind in _SIGNATURES:
        if start.startswith(signature):
            return kind
    if start.startswith((b"% evt", b"% format", b"% camera_integrator")):
        return "raw"
    return None


def _kind_by_ending(path: Path) -> str:
    ending = path.suffix.lower()
    if ending not in _KINDS:
        told = told_kind(path)
        if told is not None:
            raise FormatError(f"{path.name!r} holds no events: {told}")
        meant = nearest(ending, READABLE) if ending not in FOREIGN else ""
        raise FormatError(
            f"{path.name!r} is no event file that this version knows{meant} "
            f"(valid endings: {', '.join(READABLE)}); give it the ending of its format, or convert "
            "it with the software of its camera"
        )
    return _KINDS[ending]
