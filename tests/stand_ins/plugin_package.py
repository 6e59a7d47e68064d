"""A package as a third party would install it: modules beside a dist-info with entry points."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

MODULE = '''
import numpy as np

from spikingtac.contact.registry import EventCountDetector
from spikingtac.events.formats.arrays import ArraySource
from spikingtac.events.create import NpzWriter
from spikingtac.types import MarkerFrame


class StillTracker:
    """Says that no marker ever moves."""

    def __init__(self, calibration):
        self._reference_px = calibration.reference_px

    def absorb(self, packet):
        pass

    def estimate(self, t_us):
        rest_px, none = self._reference_px, np.zeros(len(self._reference_px))
        return MarkerFrame(t_us, rest_px, rest_px, np.zeros_like(rest_px), none > 0, none)

    def reset(self):
        pass


def build_tracker(config, calibration, law):
    return StillTracker(calibration)


def build_detector(config, calibrations, quiet):
    return EventCountDetector(len(list(quiet)))


class MineSource(ArraySource):
    """Reads .mine files."""

    format = "MINE"
'''


def install(folder: Path, points: Mapping[str, Mapping[str, str]]) -> None:
    """Write the package into a folder of the import path.

    Args:
        folder: Must be on ``sys.path``.
        points: Group -> name -> object.
    """
    (folder / "my_parts.py").write_text(MODULE, encoding="utf-8")
    info = folder / "my_parts-1.2.dist-info"
    info.mkdir()
    metadata = "Metadata-Version: 2.1\nName: my-parts\nVersion: 1.2\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    lines: list[str] = []
    for group, entries in points.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
