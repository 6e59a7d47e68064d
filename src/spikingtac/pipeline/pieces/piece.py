"""Track one piece of a recording into a file of its own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.formats.file_source import FileSource
from spikingtac.events.transform import time_slice
from spikingtac.markers.registry import make_tracker
from spikingtac.markers.tracker import MarkerTracker, PlacedTracker
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.pipeline.checked_source import CheckedSource
from spikingtac.pipeline.follow import follow
from spikingtac.pipeline.pieces.plan import Piece
from spikingtac.pipeline.pieces.seams import Agreement
from spikingtac.tracks import Tracks
from spikingtac.tracks.files import NpzTracksWriter
from spikingtac.types import MarkerFrame


@dataclass(frozen=True, slots=True)
class PieceTracking:
    """How pieces are tracked, the same for all of a recording.

    Attributes:
        config: How markers are followed; its law must be ``none``.
        calibration: The sensor's calibration.
        origin_us: Time of the recording's first estimate, us.
    """

    config: TrackingConfig
    calibration: Calibration
    origin_us: int


def track_piece(
    source: FileSource, piece: Piece, output: Path, how: PieceTracking
) -> dict[str, Any]:
    """Track a piece as if its skin rested where it begins.

    Args:
        source: The whole recording.
        piece: Which part of it.
        output: ``.npz`` file to write: the estimates from the piece's cut on.
        how: How.

    Returns:
        ``estimates``, and ``calibration_misfit`` (told for the first piece).
    """
    source.begin = piece.place
    checked = CheckedSource(source, how.calibration) if piece.number == 0 else None
    packets = time_slice(source if checked is None else checked, piece.from_us, piece.to_us)
    tracker = make_tracker(how.config, how.calibration)
    frames = follow(packets, tracker, how.config.rate_hz, source.losses, how.origin_us)
    written = _write(output, piece, how.calibration, frames)
    return {"estimates": written, "calibration_misfit": checked and checked.misfit}


def mend_piece(
    source: FileSource,
    piece: Piece,
    output: Path,
    how: PieceTracking,
    start_px: NDArray[np.float64],
    begun: Path,
) -> dict[str, Any]:
    """Track a piece again from where the markers were at its cut, until both ways agree.

    Args:
        source: The whole recording.
        piece: Which part of it.
        output: ``.npz`` file to write: the estimates from the piece's cut on.
        how: How.
        start_px: ``(m, 2)`` markers at the cut, from the piece before, px.
        begun: What :func:`track_piece` wrote.

    Returns:
        ``estimates``, the piece's ``number``, and ``agreed_us``: from then on that file is right;
        None where it never is.

    Raises:
        ConfigError: The tracking method cannot begin while the skin is deformed.
    """
    source.begin = piece.place
    packets = time_slice(source, piece.cut_us, piece.to_us)
    tracker = _placed(make_tracker(how.config, how.calibration), start_px)
    frames = follow(packets, tracker, how.config.rate_hz, source.losses, how.origin_us)
    first = Tracks.load(begun)
    agreement = Agreement(first)
    written = _write(output, piece, how.calibration, agreement.until(_with_rates(frames, first)))
    return {"estimates": written, "number": piece.number, "agreed_us": agreement.agreed_us}


def _with_rates(frames: Iterable[MarkerFrame], first: Tracks) -> Iterator[MarkerFrame]:
    """Yield frames with the rates of events of the first tracks, which knew what came before."""
    for frame in frames:
        row = int(first.t_us.searchsorted(frame.t_us))
        if first.rate_ev_s is None or row == len(first.t_us) or first.t_us[row] != frame.t_us:
            yield frame
            continue
        rate_ev_s = float(first.rate_ev_s[row])
        yield frame.with_health(replace(frame.health, rate_ev_s=rate_ev_s))


def ends_of(output: Path) -> Path:
    """Return the file beside a piece with its estimates next to its cuts, for :mod:`.seams`."""
    return output.with_name(f"{output.stem}-ends.npz")


def _placed(tracker: MarkerTracker, start_px: NDArray[np.float64]) -> MarkerTracker:
    if not isinstance(tracker, PlacedTracker):
        raise ConfigError(
            "this tracking method cannot begin while the skin is deformed, as it is at a cut of "
            "this recording; track it without --cut-s"
        )
    tracker.begin_at(start_px)
    return tracker


def _write(
    output: Path, piece: Piece, calibration: Calibration, frames: Iterable[MarkerFrame]
) -> int:
    """Write the frames that count, and once more those next to the cuts; return how many."""
    writer, written = NpzTracksWriter(output, calibration.reference_px), 0
    ends: list[MarkerFrame] = []
    try:
        for frame in frames:
            if frame.t_us < piece.cut_us:
                continue
            writer.write(frame)
            written += 1
            if piece.is_next_to_cut(frame.t_us):
                ends.append(frame)
        Tracks.of(ends, calibration).save(ends_of(output))  # first: the piece tells that it is done
        writer.close({})
    except BaseException:
        writer.abandon()
        raise
    return written
