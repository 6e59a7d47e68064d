"""Open event files, recording folders and cameras: content picks the reader, then ending."""

import io
import re
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name

from spikingtac import plugins
from spikingtac.errors import PATH, FormatError, RecordingError, nearest, require_type
from spikingtac.events.camera import Address, is_address, is_stream
from spikingtac.events.evt.raw import RawSource, later_parts, read_header
from spikingtac.events.formats.file_source import (
    CHUNK_EVENTS,
    FileSource,
    ReadOptions,
    chosen_sensor,
)
from spikingtac.events.formats.pieces import FOREIGN, UTF16_MARKS
from spikingtac.events.recording import RecordedClock, RetimedSource, name_of, time_base_of
from spikingtac.events.source import OPENED
from spikingtac.file_kinds import RECORDING_NAME, members_of, told_kind

SAMPLE_BYTES = 1 << 16  # First bytes by which a file of an unknown ending is told.
MOST_NAMED = 3  # Recordings of a folder that an error names.


def open_events(
    path: str | Path,
    *,
    strict: bool = False,
    chunk_events: int = CHUNK_EVENTS,
    sensor: int | None = None,
    encoding: str | None = None,
    size: tuple[int, int] | None = None,
) -> FileSource:
    """Open an event file, a recording folder or a camera, for reading in packets.

    Args:
        path: File, or folder with ``events.raw``. A named pipe, or ``-`` for standard input, is
            read as RAW while it comes, once; its header names encoding and size. The address of a
            camera, as ``udp:7777?encoding=evt2&size=320x320``, is read for as long as it sends.
        strict: Raise at the first damage instead of mending and counting it.
        chunk_events: About how many events a packet holds.
        sensor: Which camera of a file or folder that holds several, from 0 on; 1 of a recording
            folder opens ``events_1.raw``, on the first sensor's clock.
        encoding: RAW words to assume whatever the header says: evt2, evt21 or evt3.
        size: ``(width, height)`` to assume whatever the file says, px.

    Returns:
        A source that may be iterated again, with ``size``, ``losses``, ``triggers``, ``format`` and
        ``notes`` (what had to be assumed).

    Raises:
        RecordingError: The file is missing or cannot be read; FormatError where its content does
            not fit its header or ending.
        ConfigError: The ending or an argument is unknown, or a camera has to be chosen.
        MissingExtraError: The format needs a library of the extra ``[formats]``, or the camera one
            of its own.
        DeviceError: There is no such camera, or it refuses.
    """
    options = ReadOptions(
        strict=strict, chunk_events=chunk_events, encoding=encoding, size=size, sensor=sensor
    )
    require_type(path, PATH, OPENED)
    if is_stream(place := Path(path)):
        from spikingtac.events.camera_source import CameraSource

        return CameraSource(Address.parse(path if is_address(path) else f"pipe:{path}"), options)
    if not place.is_dir():
        if not place.exists():
            raise RecordingError(f"there is no file {str(place)!r}; check the path")
        return _open_file(place, options)
    name = name_of(RECORDING_NAME, sensor or 0)
    file = place / name
    if file.is_file():  # all parts of one sensor, on the first sensor's clock
        options = replace(options, sensor=None)
        later = later_parts(file)
        source = RawSource(file, options, later) if later else _open_file(file, options)
        time_map = time_base_of(place, sensor or 0)
        return source if time_map is None else RetimedSource(source, time_map, options)
    bags = _bags(place)
    if not bags:
        raise RecordingError(
            f"the folder {str(path)!r} holds no {name}; a recording folder has events.raw "
            f"(events_1.raw for a second sensor){_named_inside(place)}"
        )
    from spikingtac.events.ros import RosSource

    return RosSource(bags[0], options, tuple(bags[1:]))


def open_second(first: Path, second: Path, *, strict: bool = False) -> tuple[FileSource, bool]:
    """Open the other finger's recording.

    Args:
        first: Recording whose clock is the time base.
        second: The other one; the same folder again means its second sensor.
        strict: As of :func:`open_events`.

    Returns:
        The events, and whether their times are known to be on the first one's clock: else they are
        as the recording tells them.

    Raises:
        RecordingError: It cannot be read.
    """
    if is_same_folder(first, second):
        return open_events(first, strict=strict, sensor=1), True
    source = open_events(second, strict=strict)
    own = RecordedClock.beside(second)
    time_map = None if own is None else own.on(RecordedClock.beside(first))
    if time_map is None:
        return source, False
    return RetimedSource(source, time_map, ReadOptions(strict=strict)), True


def is_same_folder(first: Path, second: Path) -> bool:
    """Return whether two paths are one folder: then its second sensor is meant."""
    return first.is_dir() and second.is_dir() and first.samefile(second)


def _bags(folder: Path) -> list[Path]:
    """Return the files of a bag in a folder, in the order of their recording.

    Bags of ROS 1 whose names differ by more than numbers are no parts of one.
    """
    endings = (".db3", ".mcap") if (folder / "metadata.yaml").is_file() else (".bag",)
    files = [file for ending in endings for file in folder.glob(f"*{ending}")]
    numbers = {file: [int(number) for number in re.findall(r"\d+", file.name)] for file in files}
    if ".bag" in endings and len({re.sub(r"\d+", "", file.name) for file in files}) > 1:
        return []
    return sorted(files, key=lambda file: (numbers[file], file.name))  # 9 comes before 10


def _open_file(path: Path, options: ReadOptions) -> FileSource:
    with path.open("rb") as file:
        start = file.read(SAMPLE_BYTES)
    if not start:
        raise RecordingError(f"{str(path)!r} is empty (0 bytes): nothing was recorded into it")
    kind = _kind_by_signature(path, start)
    if kind is None:
        ending = path.suffix.lower().removeprefix(".")
        foreign = plugins.WithPlugins({}, plugins.READERS)
        if ending in foreign:
            return foreign[ending](path, options)
        kind = _kind_by_values(path, start)
    reader = resolve_name(f"spikingtac.events.{_KINDS[kind][0]}")
    if kind not in _SEVERAL:
        chosen_sensor([path.name], options.sensor, path)
    if kind == "packed":
        return reader(path, lambda inner: _open_file(inner, options))
    return reader(path, options)


def _kind_by_signature(path: Path, start: bytes) -> str | None:
    for kind, (_, _, signatures) in _KINDS.items():
        if start.startswith(signatures):
            return kind
    if start.startswith(UTF16_MARKS) and b"\0" in start[2:4]:
        return "packed"
    if start.startswith(b"PK\x03\x04"):
        names = members_of(path)
        return "packed" if names and not any(name.endswith(".npy") for name in names) else "npz"
    if start.startswith(b"%"):
        fields = read_header(io.BytesIO(start)).fields
        if fields.keys() & _RAW_FIELDS:
            return "raw"
        return "dat" if "Version" in fields else None
    return None


def _kind_by_values(path: Path, start: bytes) -> str:
    """Return the kind of a file without a signature: text, else what its ending or bytes tell.

    Raises:
        FormatError: They tell nothing that is known; says what is valid.
    """
    from spikingtac.events.evt.wire import SOUND_SHARE, best_candidate
    from spikingtac.events.formats.text import looks_like_text

    ending, told = path.suffix.lower(), told_kind(path)
    if told is not None:
        raise FormatError(f"{path.name!r} holds no events: {told}")
    if known := "text" if looks_like_text(start) else _BY_ENDING.get(ending):
        return known
    if ending not in FOREIGN and best_candidate(start, None)[1] <= SOUND_SHARE:
        return "raw"
    meant = nearest(ending, READABLE) if ending not in FOREIGN else ""
    raise FormatError(
        f"{path.name!r} is no event file that this version knows{meant} "
        f"(valid endings: {', '.join(READABLE)}); unpack it, give it the ending of its format, "
        "or convert it with the software of its camera"
    )


# Kind -> what opens its files, their endings, and how they may begin.
_KINDS: dict[str, tuple[str, tuple[str, ...], tuple[bytes, ...]]] = {
    "raw": ("evt.raw:RawSource", (".raw",), ()),
    "npz": ("formats.arrays:ArraySource", (".npz", ".npy"), (b"\x93NUMPY",)),
    "text": ("formats.text:TextSource", (".csv", ".txt", ".tsv"), ()),
    "es": ("records:EsSource", (".es",), (b"Event Stream",)),
    "dat": ("records:DatSource", (".dat",), ()),
    "aedat4": ("formats.aedat4:Aedat4Source", (".aedat4",), (b"#!AER-DAT4.0",)),
    "aedat": ("records:open_aedat", (".aedat",), (b"#!AER-DAT",)),
    "hdf5": ("formats.hdf5:Hdf5Source", (".h5", ".hdf5"), (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3")),
    "ros": (
        "ros:RosSource", (".db3", ".mcap", ".bag"),
        (b"SQLite format 3\x00", b"\x89MCAP", b"#ROSBAG"),
    ),
    "packed": ("formats.pieces:open_packed", (".gz", ".zip"), (b"\x1f\x8b",)),
}  # fmt: skip
_BY_ENDING = {ending: kind for kind, (_, endings, _) in _KINDS.items() for ending in endings}
_SEVERAL = {"aedat4", "hdf5", "ros", "packed"}  # Kinds that may hold several cameras.
READABLE = tuple(_BY_ENDING)  # Endings of what can be read; the content decides first.

# Fields of a header that only RAW files of cameras have.
_RAW_FIELDS = {
    "evt", "format", "integrator_name", "camera_integrator_name", "plugin_name", "system_ID",
    "serial_number", "firmware_version", "sensor_generation",
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
