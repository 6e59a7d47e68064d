"""Tracks: the displacement of every marker over time, in memory and on disk."""

from spikingtac.tracks.columns import CSV_COLUMNS
from spikingtac.tracks.files import FRAMES_PER_CHUNK, TracksWriter, create_tracks, is_tracks_file
from spikingtac.tracks.tracks import Tracks

__all__ = [
    "CSV_COLUMNS",
    "FRAMES_PER_CHUNK",
    "Tracks",
    "TracksWriter",
    "create_tracks",
    "is_tracks_file",
]
