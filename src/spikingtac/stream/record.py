"""Recordings from their beginning to their end: one or two cameras, and their folder."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.camera_source import CameraSource
from spikingtac.events.recording import MANIFEST, TRUTH, name_of
from spikingtac.stream.recorder import TIME_BASE, WAIT_S, Recorder
from spikingtac.types import US_PER_S

SHOW_S = 0.2  # Time between two reports of how the recording stands, s.
SENSORS = 2  # Sensors that one folder holds at most.

# File that a recorder holds locked; the system releases it however the recorder ends.
LOCK = ".recording"


_SPLIT = re.compile(r"(\d+(?:\.\d+)?)(MB|GB|s|min|h)")
_UNITS = {"MB": 10**6, "GB": 10**9, "s": US_PER_S, "min": 60 * US_PER_S, "h": 3600 * US_PER_S}


def parse_split(text: str) -> tuple[float, float]:
    """Return size, bytes, and stretch of the sensor's time, us, from which on a file is complete.

    Args:
        text: One of them, as ``500MB``, ``2GB``, ``60s``, ``10min``, ``1h``.

    Raises:
        ConfigError: It means none.
    """
    found = _SPLIT.fullmatch(text)
    amount = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if found is None or amount < 1.0:
        raise ConfigError(
            f"--split is {text!r}; give a size (500MB, 2GB) or a duration (60s, 10min, 1h)"
        )
    return (amount, math.inf) if "B" in found[2] else (math.inf, amount)


def record(
    sources: Sequence[CameraSource],
    folder: Path,
    *,
    split: tuple[float, float] = (1e9, math.inf),
    seconds: float = math.inf,
    show: Callable[[Sequence[Recorder]], object] = lambda recorders: None,
) -> dict[str, Any]:
    """Record one or two cameras until they end, are closed, or the time is up.

    Args:
        sources: The cameras; with ``when_lost="reconnect"`` one is waited for when it is gone.
        folder: An existing folder, see :func:`prepare_folder`.
        split: When the next file begins; see :func:`parse_split`.
        seconds: How long to record from when the cameras are open, s.
        show: Told how they stand, a few times a second.

    Returns:
        The summary of the first one: counts, files, camera, clock, losses, why it ended. Of two,
        ``second`` is that of the other, and ``time_base`` the map from the second clock to the
        first (None where a camera delivered nothing).
    """
    recorders: list[Recorder] = []
    begun_s = shown_s = time.monotonic()
    try:
        for number in range(len(sources)):
            recorders.append(Recorder(sources, number, folder, split))
        while any([one.step(WAIT_S / len(recorders)) for one in recorders]):
            now_s = time.monotonic()
            if now_s - begun_s >= seconds:
                for one in recorders:
                    one.end("seconds")
            if now_s - shown_s >= SHOW_S:
                shown_s = now_s
                show(recorders)
    finally:
        errors = [one.close() for one in recorders]
    for error in filter(None, errors):
        raise error
    told, *second = [one.summary() for one in recorders]
    for one in second:
        told |= {TIME_BASE: one.pop(TIME_BASE, None), "second": one}
    return told


@contextmanager
def locked_folder(folder: Path, overwrite: bool) -> Iterator[None]:
    """Keep other recorders out of a folder meanwhile; make it where it is not there.

    Raises:
        ConfigError: A recording is there, and ``overwrite`` is not given; or it is no folder.
        DeviceError: Another program records into it.
    """
    recorded(folder, overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOCK).open("w") as lock:
        try:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # another system than Linux and macOS: no lock
            pass
        except OSError as error:
            raise DeviceError(
                f"another program records into {str(folder)!r}; choose another folder"
            ) from error
        try:
            yield
        finally:
            with suppress(OSError):
                (folder / LOCK).unlink()
                folder.rmdir()  # where nothing was recorded


def prepare_folder(folder: Path, overwrite: bool) -> None:
    """Make a folder for a recording, or empty one of an earlier recording.

    Raises:
        ConfigError: A recording is there, and ``overwrite`` is not given; or it is no folder.
    """
    for path in recorded(folder, overwrite):
        path.unlink()
    folder.mkdir(parents=True, exist_ok=True)


def recorded(folder: Path, overwrite: bool) -> list[Path]:
    """Return the files of a recording that is there already, to be replaced.

    Raises:
        ConfigError: There are any, and ``overwrite`` is not given; or it is no folder.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{str(folder)!r} is a file; name a folder for the recording")
    names = [name_of(first, sensor) for first in (MANIFEST, TRUTH) for sensor in range(SENSORS)]
    old = [*folder.glob("events*.raw"), *(folder / name for name in names)]
    old = [path for path in old if path.is_file()]
    if old and not overwrite:
        raise ConfigError(
            f"{str(folder)!r} holds a recording already; choose another folder, or give "
            "--overwrite to replace it"
        )
    return old
