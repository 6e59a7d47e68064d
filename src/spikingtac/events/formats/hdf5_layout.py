"""Where the events lie in an HDF5 file, and what stands beside them; nothing is trusted."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from spikingtac.errors import FormatError
from spikingtac.events.formats.columns import ROLES, TABLE_WIDTHS, Order, order_named
from spikingtac.events.formats.packing import TIME_LIMIT_US
from spikingtac.events.formats.pieces import refuse_piece

LEAST_STORED_BYTES = 1 << 14  # Stored bytes below which no claim is weighed against them.

ROW_LIMIT_BYTES = 1 << 10  # Longest row of a table that is read; an event takes 16.

OBJECTS_LIMIT = 1 << 12  # Groups and data sets that are looked at.

COMPRESSION_LIMIT = 2_000  # Most that compression is believed to gain; deflate cannot exceed 1,032.

_RESOLUTIONS = ("calib/resolution", "resolution")

# Longest search for attributes, s: a sound file needs 0.3 s, the start of Python included.
TIME_LIMIT_S = 20.0

# Prints, as JSON, the attributes that tell a size in the files of Metavision, of this package and
# of DSEC; a longer value is no size.
_ATTRIBUTES = """
import h5py, json, sys
def plain(value):
    value = getattr(value, "tolist", lambda: value)()
    value = value.decode(errors="replace") if isinstance(value, bytes) else value
    return value if len(str(value)) <= 64 else None
names = ("geometry", "width", "height", "sensor_resolution")
with h5py.File(sys.argv[1], "r") as file:
    every = [file[name].attrs for name in sys.argv[2:]]
    found = [{name: plain(at[name]) for name in names if name in at} for at in every]
print(json.dumps(found, default=str))
"""


class EventStream(NamedTuple):
    """The events of one camera.

    Attributes:
        group: Name of the group that they lie in.
        places: Data set of each role, in the order of ``ROLES``; the same one for a table.
        order: Fields or columns of the roles within a table; None where each has its data set.
        unit: Unit of the times that a name told.
    """

    group: str
    places: tuple[str, ...]
    order: Order | None = None
    unit: str | None = None


def find_streams(file: Any, path: Path) -> list[EventStream]:
    """Return every stream of events, in the order of their names; links are not followed."""
    found: list[EventStream] = []
    links: list[str] = []
    groups, looked_at = [file], 0
    while groups and looked_at < OBJECTS_LIMIT:
        group = groups.pop()
        names = sorted(group.keys())
        looked_at += len(names)
        tables: dict[str, Any] = {}
        for name in names:
            if hasattr(group.get(name, getlink=True), "path"):  # a soft or an external one
                links.append(name)
                continue
            item = group[name]
            if hasattr(item, "dtype"):
                tables[name] = item
            elif hasattr(item, "keys"):
                groups.append(item)
        found += _streams_of(group, tables)
    if not found:
        more = f"; {', '.join(links)} is a link, which is not followed: copy it" if links else ""
        raise FormatError(
            f"{str(path)!r} holds no events: neither a group with columns named x, y, p and t, nor "
            f"a table of such fields or of four numbers{more}"
        )
    return sorted(found, key=lambda stream: stream.places)


def _streams_of(group: Any, tables: dict[str, Any]) -> Iterator[EventStream]:
    rows = [
        (name, item)
        for name, item in tables.items()
        if len(item.shape or ()) == 1 and item.dtype.kind in "uifb"
    ]
    order = order_named([name for name, _ in rows])
    if order is not None:
        places = tuple(rows[order.place[role]][1].name for role in ROLES)
        yield EventStream(group.name, places, unit=order.unit)
    for name, item in tables.items():
        places = (item.name,) * len(ROLES)
        if item.dtype.names and (fields := order_named(item.dtype.names)):
            yield EventStream(group.name, places, fields, fields.unit)
        wide = len(item.shape or ()) == 2 and item.shape[1] in TABLE_WIDTHS
        if wide and "event" in name.lower() and item.dtype.kind in "uif":
            yield EventStream(group.name, places)


def require_plain(dataset: Any, path: Path) -> None:
    """Refuse what is no plain row or table of numbers in this file, or claims too much.

    Raises:
        FormatError: The dataset is odd, lies in other files, or its chunks are beyond the limit.
    """
    where = f"{str(path)!r}: {dataset.name!r}"
    fields = dataset.dtype.fields
    types = [entry[0] for entry in fields.values()] if fields else [dataset.dtype]
    if not all(kind.kind in "uifb" and not kind.shape for kind in types):
        raise FormatError(f"{where} is {dataset.dtype}; rows of numbers are needed")
    if dataset.external or dataset.is_virtual:
        raise FormatError(f"{where} lies in other files, which are not read; copy it into this one")
    row_bytes = dataset.dtype.itemsize
    if row_bytes > ROW_LIMIT_BYTES:
        raise FormatError(f"{where} has rows of {row_bytes} bytes (valid: to {ROW_LIMIT_BYTES})")
    if dataset.chunks is not None:
        refuse_piece(f"{where}: a chunk", 2 * int(np.prod(dataset.chunks)) * row_bytes)


def rows_in(dataset: Any) -> int:
    """Return a dataset's rows.

    Raises:
        ValueError: It claims more than its bytes can hold, and reading it would not end.
    """
    claimed = dataset.size * dataset.dtype.itemsize
    if claimed > COMPRESSION_LIMIT * max(dataset.id.get_storage_size(), LEAST_STORED_BYTES):
        raise ValueError(f"{dataset.name} claims {claimed} bytes")
    return len(dataset)


def _beside(file: Any, group: str, names: tuple[str, ...]) -> Any:
    """Return the first data set of some names in a group or one that holds it, or None."""
    while True:
        for name in names:
            place = f"{group.rstrip('/')}/{name}"
            if place in file and not getattr(file[place], "external", None):
                return file[place]
        if group in ("", "/"):
            return None
        group = group.rpartition("/")[0]


def offset_of(file: Any, group: str) -> int | None:
    """Return what is added to the times, us; None where it cannot be meant."""
    offset = _beside(file, group, ("t_offset",))
    if offset is None:
        return 0
    if getattr(offset, "shape", None) not in ((), (1,)) or offset.dtype.kind not in "ui":
        return None
    value = int(np.ravel(offset[()])[0])
    return value if abs(value) <= TIME_LIMIT_US else None


def size_of(file: Any, path: Path, group: str) -> tuple[int, int] | None:
    """Return the size that an attribute or a data set beside the events tells, or None.

    Raises:
        ValueError: The attributes are damaged, or tell no size.
    """
    names = ["/", group] + [f"{group.rstrip('/')}/events"] * (f"{group}/events" in file)
    for attributes in read_attributes(path, names):
        if "geometry" in attributes:
            width, _, height = str(attributes["geometry"]).partition("x")
            if width.isdigit() and height.isdigit():
                return int(width), int(height)
        if "width" in attributes and "height" in attributes:
            return int(attributes["width"]), int(attributes["height"])
        if "sensor_resolution" in attributes:
            height, width = (int(value) for value in attributes["sensor_resolution"][:2])
            return width, height
    resolution = _beside(file, group, _RESOLUTIONS)
    if resolution is not None and getattr(resolution, "shape", None) == (2,):
        width, height = (int(value) for value in resolution[:])
        return width, height
    return None


def read_attributes(path: Path, objects: Sequence[str]) -> list[dict[str, Any]]:
    """Return the attributes of each object that tell a size: numbers, lists, strings.

    A damaged attribute can make the HDF5 library search without end, where nothing in the same
    process can interrupt it: they are read in another one, which can be ended.

    Args:
        path: The file.
        objects: Absolute names of groups and data sets in it.

    Raises:
        ValueError: They cannot be read, or not within ``TIME_LIMIT_S``; says so.
    """
    command = [sys.executable, "-P", "-c", _ATTRIBUTES, str(path), *objects]
    try:
        done = subprocess.run(
            command, capture_output=True, stdin=subprocess.DEVNULL, timeout=TIME_LIMIT_S
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"no end of its attributes within {TIME_LIMIT_S:g} s") from None
    if done.returncode:
        told = done.stderr.decode(errors="replace").strip().splitlines() or ["the reader died"]
        raise ValueError(f"its attributes cannot be read: {told[-1]}")
    return list(json.loads(done.stdout))
