"""The paper's state map: each pixel remembers the polarity of its last event (Eq. 1).

Its limits: a marker's edge crosses several contrast thresholds, but the first ON event of the
leading edge already paints, and the first OFF event of the trailing edge already erases. So the
painted disc leads the marker, and stays ahead when the motion stops. Nor does the map decay: noise
paints the ground until half of it is white. ``docs/explanation/errata.md``
has figures.

The paper begins with a null map and slides an object over the skin before each session (section
IV-B). A sensor whose markers are known at rest can begin with a painted map instead.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket, FloatArray


class StateMap(Protocol):
    """A persistent image of the skin that events keep up to date."""

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` from 0 (ground) to 1 (marker); a view, to be read and not kept."""
        ...

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time."""
        ...

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        ...


class BinaryStateMap:
    """The map M of Eq. 1: an ON event paints its pixel white, an OFF event black.

    Attributes:
        values: ``(height, width)`` float32 of 0 and 1; the next packet changes it.

    Example:
        >>> import numpy as np
        >>> from spikingtac.types import EventPacket
        >>> state_map = BinaryStateMap((4, 3))
        >>> one = np.array([2], np.uint16)
        >>> state_map.absorb(EventPacket(one, one, one > 0, np.array([5]), 0, 10, (4, 3)))
        >>> float(state_map.values[2, 2])
        1.0
    """

    def __init__(
        self,
        size: tuple[int, int],
        start: NDArray[np.float32] | None = None,
        *,
        dark_markers: bool = False,
    ) -> None:
        """Begin with an empty map, or with a painted one (:func:`paint_binary_discs`).

        Args:
            size: ``(width, height)``, px.
            start: ``(height, width)`` map to begin with; the paper begins with the null matrix.
            dark_markers: True where markers are darker than the ground: polarities swap.
        """
        self._start = np.zeros(size[::-1], np.float32) if start is None else start.astype("f4")
        self.values = self._start.copy()
        self._dark_markers = dark_markers

    def absorb(self, packet: EventPacket) -> None:
        """Paint every event of a packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self.values.shape)
        # The last of a pixel's events wins: NumPy assigns in order.
        self.values[packet.y, packet.x] = packet.p != self._dark_markers

    def reset(self) -> None:
        """Go back to the map that the object was made with."""
        self.values[:] = self._start


def paint_discs(
    size: tuple[int, int],
    reference_px: FloatArray,
    radius_px: FloatArray,
) -> NDArray[np.float32]:
    """Paint discs with sharp edges, so that a calibrated sensor needs no new slides.

    Each pixel holds its coverage by a straight edge at its distance. This differs
    from the exact coverage by less than 0.1 for discs of 3 px and more.

    Args:
        size: ``(width, height)``, px.
        reference_px: ``(m, 2)`` centres, px; they may lie beyond the border.
        radius_px: ``(m,)`` radii, px.

    Returns:
        ``(height, width)`` float32 from 0 to 1.

    Example:
        >>> import numpy as np
        >>> paint_discs((9, 9), np.array([[4.0, 4.0]]), np.array([2.0]))[4].tolist()
        [0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]
    """
    width, height = size
    levels = np.zeros((height, width), np.float32)
    for (x, y), radius in zip(reference_px, radius_px, strict=True):
        reach = float(radius) + 1.0
        columns = np.arange(max(0, int(x - reach)), min(width, int(x + reach) + 2))
        rows = np.arange(max(0, int(y - reach)), min(height, int(y + reach) + 2))
        if columns.size and rows.size:
            distance = np.hypot(columns[np.newaxis, :] - x, rows[:, np.newaxis] - y)
            patch = levels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            np.maximum(patch, np.clip(0.5 + float(radius) - distance, 0.0, 1.0), out=patch)
    return levels


def paint_binary_discs(
    size: tuple[int, int], reference_px: FloatArray, radius_px: FloatArray
) -> NDArray[np.float32]:
    """Paint discs of ones: the pixels whose centre a disc covers; see :func:`paint_discs`."""
    # Half of a pixel is covered whose centre lies on the rim.
    return (paint_discs(size, reference_px, radius_px) >= np.float32(0.5)).astype(np.float32)
