"""Tracks: the displacement of every marker over time, in memory and on disk."""

from spikingtac.tracks.files import FRAMES_PER_CHUNK, TracksWriter, create_tracks
from spikingtac.tracks.tracks import Tracks

__all__ = ["FRAMES_PER_CHUNK", "Tracks", "TracksWriter", "create_tracks"]
