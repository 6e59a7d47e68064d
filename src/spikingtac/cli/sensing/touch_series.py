"""Arrays of another sensor as frames, for ``spikingtac touch``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from spikingtac.touch.force.wrench_series import WrenchSeries
    from spikingtac.touch.touches.touch_config import TouchConfig
    from spikingtac.types import MarkerFrame

SCATTER_SHARE = 0.03
"""Scatter of markers of another sensor, as a share of their pitch (ours: 0.045 mm of 1.6 mm on a
published series at rest)."""


def touch_config(reference: NDArray[Any], unit: str) -> TouchConfig:
    """Return the settings: those of events, or of places from a sensor that sees no changes.

    Args:
        reference: ``(m, 2)`` markers at rest, in ``unit``.
        unit: ``px`` of an event camera, or ``mm``.
    """
    import numpy as np

    from spikingtac.touch.touches.backlash import NOTHING_UNSEEN
    from spikingtac.touch.touches.touch_config import TouchConfig

    if unit == "px":
        return TouchConfig()
    away = ((reference[:, None] - reference[None]) ** 2).sum(axis=2)
    np.fill_diagonal(away, np.inf)
    pitch = float(np.sqrt(np.median(away.min(axis=1))))
    return TouchConfig(least_displacement_px=SCATTER_SHARE * pitch, unseen=NOTHING_UNSEEN)


def frames_of(series: WrenchSeries) -> Iterator[MarkerFrame]:
    """Yield the frames of a series that was measured by another sensor."""
    import numpy as np

    from spikingtac.types import MarkerFrame

    markers = len(series.reference)
    for t_us, moved in zip(series.t_us, series.displacement, strict=True):
        place = series.reference + moved
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        yield MarkerFrame(int(t_us), place, place, moved, seen, sure)
