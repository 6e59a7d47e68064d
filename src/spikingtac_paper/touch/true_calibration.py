"""The calibration that a simulated sensor would have without error."""

from __future__ import annotations

from spikingtac import Calibration
from spikingtac.sim import SceneSource


def true_calibration(source: SceneSource) -> Calibration:
    """Return the calibration of a scene's sensor, from its truth."""
    return Calibration(
        reference_px=source.reference_px,
        radius_px=source.radius_px,
        grid=source.scene.skin.grid,
        size=source.size,
        polarity="white",
    )
