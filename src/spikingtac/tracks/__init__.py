"""Tracks: the displacement of every marker over time, in memory and on disk."""

from spikingtac.tracks.files import CSV_COLUMNS, FRAMES_PER_CHUNK, TracksWriter, create_tracks
from spikingtac.tracks.tracks import Tracks, is_tracks_file

__all__ = [
    "CSV_COLUMNS",
    "FRAMES_PER_CHUNK",
    "Tracks",
    "TracksWriter",
    "create_tracks",
    "is_tracks_file",
]
