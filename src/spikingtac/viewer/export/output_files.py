"""The files that a showing leaves behind, and the care not to write over anybody else's."""

from __future__ import annotations

import zipfile
from pathlib import Path

from spikingtac.errors import ConfigError, RecordingError, nearest
from spikingtac.plots.summary import CREATOR, PICTURE_ENDINGS
from spikingtac.tracks import Tracks
from spikingtac.viewer.session.track_recorder import TRACKS_MAKER

ARCHIVE_START, FIRST_ARRAY = b"PK\x03\x04", b"t_us.npy"
CUT_START_BYTES = 64
"""The first array's name lies within so many bytes."""


def tracks_beside(picture: Path) -> Path:
    """Return where the tracks that belong to a picture go: ``demo.png``, ``demo.tracks.npz``."""
    return picture.with_name(f"{picture.stem}.tracks.npz")


def check_picture(path: Path) -> None:
    """Refuse a picture that could not be written at the end, before anything is shown.

    Raises:
        ConfigError: The ending is no picture's, the folder does not exist, or a file is there that
            this program did not make.
    """
    if path.suffix not in PICTURE_ENDINGS:
        hint = nearest(path.suffix, PICTURE_ENDINGS)
        valid = ", ".join(PICTURE_ENDINGS)
        raise ConfigError(f"cannot draw {path.name!r}{hint} (valid endings: {valid})")
    _check_folder(path)
    if path.exists() and not (path.is_file() and CREATOR.encode() in path.read_bytes()):
        raise _taken(path)


def check_tracks(path: Path) -> None:
    """Refuse a tracks file in the place of one that the demo did not make.

    Tracks that a showing left unfinished are nobody's, and are replaced.

    Raises:
        ConfigError: The folder does not exist, or such a file is there.
    """
    _check_folder(path)
    if not path.exists():
        return
    try:
        ours = Tracks.load(path).meta.get("made_by") == TRACKS_MAKER
    except RecordingError:
        ours = path.is_file() and _is_cut(path)
    if not ours:
        raise _taken(path)


def _is_cut(path: Path) -> bool:
    """Return whether a file begins as tracks do and ends before the archive's index."""
    with path.open("rb") as file:
        start = file.read(CUT_START_BYTES)
    begins = not start or (start.startswith(ARCHIVE_START) and FIRST_ARRAY in start)
    return begins and not zipfile.is_zipfile(path)


def _check_folder(path: Path) -> None:
    if not path.parent.is_dir():
        raise ConfigError(f"the folder {str(path.parent)!r} does not exist; create it first")


def _taken(path: Path) -> ConfigError:
    return ConfigError(
        f"{str(path)!r} is there and was not made by this command; "
        "move it away, or name another place: -o NAME.png"
    )
