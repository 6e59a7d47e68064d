"""The folder of a recording: locked while it is written, never replaced unasked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spikingtac.errors import ConfigError, DeviceError
from spikingtac.events.manifest import MANIFEST, TRUTH, name_of

SENSORS = 2  # Sensors that one folder holds at most.

# File that a recorder holds locked; the system releases it however the recorder ends.
LOCK = ".recording"


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
