"""What a view is tracked into without a page: figures, pictures, animations, messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import replacing, require_free
from spikingtac.errors import ConfigError, nearest
from spikingtac.plots.summary import PICTURE_ENDINGS
from spikingtac.viewer.export.stretch import draw_stretch, open_stretch
from spikingtac.viewer.source import ViewSource

ENDINGS = (".mcap", ".rrd", ".mp4", ".gif", *PICTURE_ENDINGS)

# Twenty frames per second: GIF counts in 10 ms, and browsers slow down what is below 20 ms.
GIF_FRAME_MS, GIF_COLORS = 50, 32

# Moments of a course, more than a figure has pixels, and the least time between two, us.
LOOKS, LEAST_STEP_US = 4_000, 10_000


def export(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view into a file; return the number of messages or pictures.

    Args:
        view: From :func:`spikingtac.viewer.opening.open_view_source`.
        path: ``.mcap`` (ROS 2 schemas), ``.rrd`` (Rerun), ``.mp4``, ``.gif``, or one picture:
            ``.png``, ``.svg``, ``.pdf``.
        seconds: Length of the stretch from its beginning; None is all of it.

    Raises:
        ConfigError: The ending is another, the folder does not exist, the source does not end and
            no length was given, or nothing was tracked.
        MissingExtraError: The format needs an extra.
    """
    target = Path(path)
    check_target(target, True)
    with replacing(target) as partial:
        if target.suffix in PICTURE_ENDINGS:
            summarize(view, seconds=seconds, picture=partial)
            return 1
        if target.suffix == ".mcap":
            from spikingtac.viewer.export.mcap import export_mcap as write
        elif target.suffix == ".rrd":
            from spikingtac.viewer.export.rrd import export_rrd as write
        elif target.suffix == ".mp4":
            from spikingtac.viewer.export.mp4 import export_mp4 as write
        else:
            write = export_gif
        return write(view, partial, seconds=seconds)


def check_target(path: Path, overwrite: bool, endings: Sequence[str] = ENDINGS) -> None:
    """Refuse a file that no export writes or may not replace, before anything is tracked.

    Raises:
        ConfigError: The ending is another, the folder does not exist, or something is there.
    """
    if path.suffix not in endings:
        hint, valid = nearest(path.suffix, endings), ", ".join(endings)
        raise ConfigError(f"cannot write {path.name!r}{hint} (valid endings: {valid})")
    require_free(path, overwrite)


def summarize(
    view: ViewSource, *, seconds: float | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """Track a recording as fast as the machine can, and return its figures.

    Args:
        view: A recording, with its calibration or without.
        seconds: Length of the stretch from its beginning; None is all of it.
        picture: File for the moment of largest displacement beside the whole course, or None.

    Raises:
        ConfigError: The source does not end and no length was given, or it holds nothing.
    """
    with open_stretch(view, seconds) as stretch:
        playback, record = stretch.playback, stretch.record
        step_us = max((stretch.end_us - playback.position_us) // LOOKS, LEAST_STEP_US)
        while stretch.advance(step_us):
            record.take(view, playback)
        if picture is not None:
            record.save_picture(picture, view, playback)
        return record.summary(view, playback)


def export_gif(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view and write an animated GIF; see :func:`export`."""
    first, *rest = pictures = draw_stretch(view, GIF_FRAME_MS, GIF_COLORS, seconds)
    first.save(
        path, save_all=True, append_images=rest, duration=GIF_FRAME_MS, loop=0, optimize=True
    )
    return len(pictures)


def tracks_beside(picture: Path) -> Path:
    """Return where the tracks that belong to a picture go: ``demo.png``, ``demo.tracks.npz``."""
    return picture.with_name(f"{picture.stem}.tracks.npz")
