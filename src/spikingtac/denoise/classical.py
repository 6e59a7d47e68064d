"""The denoisers by name; those without a network: none, a 3x3 median and a 7x7 box.

The paper compares its network with nothing. These filters are the reference that a network has to
improve on. On a binary map the median is the majority of nine pixels. Beyond the border both
filters repeat the nearest pixel of the map (``mode="nearest"`` of scipy.ndimage), so that a marker
at the border keeps its level.
"""

from collections.abc import Callable
from functools import partial, reduce
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import named

Map = NDArray[np.float32]
# Pixels on each side of the centre of the 7x7 box: about half a marker's radius on 320x320.
BOX_REACH = 3


class Denoiser(Protocol):
    """Turns a noisy state map into a denoised one of the same shape."""

    def clean(self, state_map: Map) -> Map:
        """Return the denoised map.

        Args:
            state_map: ``(height, width)`` float32 from 0 (ground) to 1 (marker).

        Returns:
            ``(height, width)`` float32 from 0 to 1. The next call may overwrite it.
        """
        ...


class NoDenoiser:
    """Returns the map unchanged."""

    def clean(self, state_map: Map) -> Map:
        """Return the given array itself."""
        return state_map


class Median3:
    """The median of each pixel's 3x3 neighbourhood: removes lone pixels, keeps edges.

    Example:
        >>> import numpy as np
        >>> lone = np.zeros((5, 5), np.float32)
        >>> lone[2, 2] = 1.0
        >>> float(Median3().clean(lone).max())
        0.0
    """

    def clean(self, state_map: Map) -> Map:
        """Return the median map of a ``(height, width)`` float32 one."""
        from scipy.ndimage import median_filter  # a late import: few ask for it

        return median_filter(state_map, 3, mode="nearest")


class Box7:
    """The mean of each pixel's 7x7 neighbourhood: strongest against noise, blurs edges evenly.

    Example:
        >>> import numpy as np
        >>> round(float(Box7().clean(np.eye(7, dtype=np.float32))[3, 3]), 4)
        0.1429
    """

    def clean(self, state_map: Map) -> Map:
        """Return the mean map of a ``(height, width)`` float32 one."""
        # Sums instead of a running sum: no rounding error accumulates from pixel to pixel.
        height, width = state_map.shape
        padded = np.pad(state_map, BOX_REACH, mode="edge")
        side = 2 * BOX_REACH + 1
        rows = reduce(np.add, (padded[i : i + height] for i in range(side)))
        total = reduce(np.add, (rows[:, i : i + width] for i in range(side)))
        return total * np.float32(1.0 / side**2)


# Name in the ``denoise`` experiment -> class; none of them has anything to set.
CLASSICAL_DENOISERS: dict[str, type[Denoiser]] = {
    "none": NoDenoiser,
    "median3": Median3,
    "box7": Box7,
}


def _network(name: str) -> Denoiser:
    from spikingtac.denoise.infer import shipped_denoiser  # with ONNX Runtime behind it

    return shipped_denoiser(name)


# ``tracking.denoiser`` -> builder.
DENOISERS: dict[str, Callable[[], Denoiser]] = {
    **CLASSICAL_DENOISERS,
    **{name: partial(_network, name) for name in ("network", "network-int8")},
}


def make_denoiser(name: str) -> Denoiser:
    """Build the denoiser of a name."""
    return named(DENOISERS, name, "denoiser")()
