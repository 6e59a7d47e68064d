"""Exports by the file's ending."""

from __future__ import annotations

from pathlib import Path

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError, nearest
from spikingtac.plots.summary import PICTURE_ENDINGS
from spikingtac.viewer.session.source import ViewSource

ENDINGS = (".mcap", ".rrd", ".mp4", ".gif", *PICTURE_ENDINGS)


def export(view: ViewSource, path: str | Path, *, seconds: float | None = None) -> int:
    """Track a view into a file; return the number of messages or pictures.

    Args:
        view: From :func:`spikingtac.viewer.session.opening.open_view_source`.
        path: ``.mcap`` (ROS 2 schemas), ``.rrd`` (Rerun), ``.mp4``, ``.gif``, or one picture:
            ``.png``, ``.svg``, ``.pdf``.
        seconds: Length of the stretch from its beginning; None is all of it.

    Raises:
        ConfigError: The ending is another, or the folder does not exist.
        MissingExtraError: The format needs an extra.
    """
    target = Path(path)
    check_target(target, overwrite=True)
    with replacing(target) as partial:
        if target.suffix == ".mcap":
            from spikingtac.viewer.export.mcap import export_mcap

            return export_mcap(view, partial, seconds=seconds)
        if target.suffix == ".rrd":
            from spikingtac.viewer.export.rrd import export_rrd

            return export_rrd(view, partial, seconds=seconds)
        if target.suffix == ".mp4":
            from spikingtac.viewer.export.mp4 import export_mp4

            return export_mp4(view, partial, seconds=seconds)
        if target.suffix in PICTURE_ENDINGS:
            from spikingtac.viewer.export.summary_picture import export_picture

            return export_picture(view, partial, seconds=seconds)
        from spikingtac.viewer.export.gif import export_gif

        return export_gif(view, partial, seconds=seconds)


def check_target(path: Path, *, overwrite: bool) -> None:
    """Refuse a file that no export writes or may not replace, before anything is tracked.

    Raises:
        ConfigError: The ending is another, the folder does not exist, or something is there.
    """
    if path.suffix not in ENDINGS:
        valid = ", ".join(ENDINGS)
        hint = nearest(path.suffix, ENDINGS)
        raise ConfigError(f"cannot export to {path.name!r}{hint} (valid endings: {valid})")
    if not path.parent.is_dir():
        raise ConfigError(f"the folder {str(path.parent)!r} does not exist; create it first")
    if path.is_dir() or (path.exists() and not overwrite):
        raise ConfigError(
            f"{str(path)!r} is there already; "
            "choose another name, or give --overwrite to replace a file"
        )
