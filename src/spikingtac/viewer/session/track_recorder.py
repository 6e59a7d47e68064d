"""Keeps the tracks of a session at the full rate; its pages see only some of the estimates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac._version import package_version
from spikingtac.tracks import create_tracks
from spikingtac.types import MarkerFrame

TRACKS_MAKER = "spikingtac demo"
"""What the tracks say about who made them."""


class TrackRecorder(Protocol):
    """Takes every estimate of a session."""

    def take(self, frame: MarkerFrame) -> None:
        """Take the next estimate; one of an earlier time where the session went back."""
        ...

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete what was kept."""
        ...


class NullTrackRecorder:
    """The :class:`TrackRecorder` of a session that writes no tracks."""

    def take(self, frame: MarkerFrame) -> None:
        """Let the estimate go."""

    def close(self, meta: Mapping[str, Any]) -> None:
        """Do nothing."""


class FileTrackRecorder:
    """Writes a tracks file that holds each time once, in order.

    What is played again, scrubbed through or tracked again with other settings is not written a
    second time, so a recording that repeats leaves tracks of its own length.
    """

    def __init__(self, path: Path, reference_px: NDArray[np.float64]) -> None:
        """Begin; see :func:`spikingtac.tracks.create_tracks`."""
        self._writer = create_tracks(path, reference_px)
        self._last_us: int | None = None

    def take(self, frame: MarkerFrame) -> None:
        """Write an estimate that is later than all before it."""
        if self._last_us is None or frame.t_us > self._last_us:
            self._last_us = frame.t_us
            self._writer.write(frame)

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file."""
        made = {"made_by": TRACKS_MAKER, "package_version": package_version()}
        self._writer.close({**made, **meta})
