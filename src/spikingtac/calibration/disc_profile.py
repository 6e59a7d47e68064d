"""The brightness of a marker's disc across its edge, in units of the full swing.

The skin is ground (intensity 1) and disc (intensity ``contrast``), blurred by the lens: a logistic
edge of scale ``edge_px``. Event cameras see the logarithm, so that the normalised level at signed
distance q outside of the nominal radius is

    S(q) = ln(1 + k / (1 + exp(q / s))) / ln(1 + k),  k = contrast - 1, s = edge_px,

1 in the disc, 0 on the ground, and above one half at the nominal radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError

REACH_EDGES = 6.5  # S is within 0.005 of its limits this many edge scales to both sides of the rim.

# Marker over ground intensity where nothing was calibrated (the twin's presets).
CONTRAST_DEFAULT = 6.0

# Logistic edge scale where nothing was calibrated: a pixel box with half a pixel of lens blur.
EDGE_DEFAULT_PX = 0.55


@dataclass(frozen=True)
class DiscProfile:
    """S(q) of one sensor; see the module for the formula.

    Attributes:
        contrast: Intensity of the disc over that of the ground, above 1.
        edge_px: Logistic scale of the edge, px.
    """

    contrast: float = CONTRAST_DEFAULT
    edge_px: float = EDGE_DEFAULT_PX

    def __post_init__(self) -> None:
        if not self.contrast > 1.0:
            raise ConfigError(
                f"contrast is {self.contrast}, the disc must be brighter than its ground (above 1);"
                " for dark markers give the ratio ground over marker and polarity 'dark'"
            )
        if not self.edge_px > 0.0:
            raise ConfigError(f"edge_px is {self.edge_px}, it must be positive")

    @property
    def reach_px(self) -> float:
        """Distance from the nominal radius beyond which the level is flat, px."""
        return REACH_EDGES * self.edge_px

    def level(self, q_px: NDArray[np.floating] | float) -> NDArray[np.float64]:
        """Return S(q) for distances of any shape, px (negative inside of the disc)."""
        k = self.contrast - 1.0
        inside = 1.0 / (1.0 + np.exp(np.clip(np.asarray(q_px, float) / self.edge_px, -40.0, 40.0)))
        return np.log1p(k * inside) / np.log1p(k)

    def slope(self, q_px: NDArray[np.floating] | float) -> NDArray[np.float64]:
        """Return dS/dq, 1/px (negative)."""
        k = self.contrast - 1.0
        inside = 1.0 / (1.0 + np.exp(np.clip(np.asarray(q_px, float) / self.edge_px, -40.0, 40.0)))
        numerator = -k * inside * (1.0 - inside) / self.edge_px
        return numerator / (1.0 + k * inside) / np.log1p(k)


def disc_profiles(calibration: Calibration) -> list[DiscProfile]:
    """Return each marker's profile: its own where it is known, else the sensor's, else usual.

    Raises:
        ConfigError: A contrast is not above 1, or an edge is not positive.
    """
    count = len(calibration.reference_px)
    contrast = calibration.marker_contrast
    if contrast is None:
        contrast = np.full(count, calibration.contrast or CONTRAST_DEFAULT)
    edge_px = calibration.marker_edge_px
    if edge_px is None:
        edge_px = np.full(count, calibration.edge_px or EDGE_DEFAULT_PX)
    pairs = zip(contrast.tolist(), edge_px.tolist(), strict=True)
    return [DiscProfile(ratio, edge) for ratio, edge in pairs]
