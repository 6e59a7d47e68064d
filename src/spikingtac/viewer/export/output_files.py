"""The files that a showing leaves behind, checked before anything is shown."""

from __future__ import annotations

from pathlib import Path

from spikingtac.atomic_files import require_free
from spikingtac.errors import ConfigError, nearest
from spikingtac.plots.summary import PICTURE_ENDINGS


def tracks_beside(picture: Path) -> Path:
    """Return where the tracks that belong to a picture go: ``demo.png``, ``demo.tracks.npz``."""
    return picture.with_name(f"{picture.stem}.tracks.npz")


def check_picture(path: Path, overwrite: bool) -> None:
    """Refuse a picture that could not be written at the end, before anything is shown.

    Raises:
        ConfigError: The ending is no picture's, the folder does not exist, or a file is there that
            nobody said may be replaced.
    """
    if path.suffix not in PICTURE_ENDINGS:
        hint = nearest(path.suffix, PICTURE_ENDINGS)
        valid = ", ".join(PICTURE_ENDINGS)
        raise ConfigError(f"cannot draw {path.name!r}{hint} (valid endings: {valid})")
    require_free(path, overwrite)
