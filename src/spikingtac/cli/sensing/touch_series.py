"""Arrays of another sensor as frames, for ``spikingtac touch``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spikingtac.touch.force.wrench_series import WrenchSeries
    from spikingtac.types import MarkerFrame


def frames_of(series: WrenchSeries) -> Iterator[MarkerFrame]:
    """Yield the frames of a series that was measured by another sensor."""
    import numpy as np

    from spikingtac.types import MarkerFrame

    markers = len(series.reference)
    for t_us, moved in zip(series.t_us, series.displacement, strict=True):
        place = series.reference + moved
        seen, sure = np.zeros(markers, np.bool_), np.ones(markers)
        yield MarkerFrame(int(t_us), place, place, moved, seen, sure)
