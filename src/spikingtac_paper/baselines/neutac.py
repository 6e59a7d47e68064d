"""NeuTac's tracker: denoise the time surface, detect, associate; without a gain law.

Source: the description of NeuTac's denoising-based detection in the SpikingTac paper (section V-A).
Neither its code nor the loss of its network is public.

Re-derived: continuous event time surface -> denoiser -> threshold -> blobs -> association, anew in
every frame. A marker without a blob keeps its last place. The surface decays to grey with a time
constant that is not published; it was tuned on separate training scenes
(``benchmarks/tune_baselines.py``), as was the threshold.

Differences: a background-activity filter goes first. Without it, leak and noise turn either map
white within seconds, and nothing is found any more. The denoiser is that of this package's
``paper`` preset, so that the comparison concerns surfaces and laws and not networks. On the
last-polarity map the same pipeline is that preset without its law, which the experiment shows as
``neutac-binary``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac import Calibration
from spikingtac.config import load_config
from spikingtac.denoise import make_denoiser
from spikingtac.markers import BlobTracker, BlobTrackerConfig
from spikingtac.state_map import paint_binary_discs
from spikingtac.types import EventPacket

RATE_HZ = 300.0  # Estimates per second, Hz (table I of the SpikingTac paper).


def neutac_tracker(
    calibration: Calibration,
    *,
    support_us: int = 5_000,
    decay_us: float = 100_000_000.0,
    level: float = 0.5,
) -> BlobTracker:
    """Assemble the published stages from those of this package, behind a filter of isolated events.

    Args:
        calibration: Rest positions of the markers; the initial surface is drawn from it.
        support_us: Window of the background-activity filter, us (tuned).
        decay_us: Time constant of the time surface, us (tuned).
        level: Threshold on the denoised time surface; 0.5 is grey (tuned).
    """
    denoiser = make_denoiser(load_config("paper").tracking.denoiser)
    start = paint_binary_discs(calibration.size, calibration.reference_px, calibration.radius_px)
    surface = TimeSurface(start, decay_us, dark_markers=calibration.polarity == "dark")
    blobs = BlobTrackerConfig(threshold=level, support_us=support_us, refresh_us=0)
    return BlobTracker(blobs, calibration, denoiser, state_map=surface)


GREY = np.float32(0.5)  # Value of a pixel without a recent event.

# Number of time constants after which time zero is moved; exp(20) is far from float32's limit.
REBASE_DECAYS = 20.0


class TimeSurface:
    """The map (1 + p exp(-(t - t_last) / τ)) / 2 of each pixel's last event.

    Source: X. Lagorce et al., "HOTS: a hierarchy of event-based time-surfaces for pattern
    recognition", IEEE PAMI 39, 2017 (the exponential decay), signed by the polarity.

    Args:
        start: ``(height, width)`` of 0 and 1: initial state, as if every pixel had just fired.
        decay_us: τ, us.
        dark_markers: True if markers are darker than the ground: the polarities are swapped.
    """

    def __init__(
        self, start: NDArray[np.float32], decay_us: float, *, dark_markers: bool = False
    ) -> None:
        self._start, self._decay_us, self._dark = start, decay_us, dark_markers
        self._values = np.empty_like(start, np.float32)
        self.reset()

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` values after the last packet; the next access overwrites them."""
        np.multiply(self._weight, self._decay(), out=self._values)
        self._values += GREY
        return self._values

    def absorb(self, packet: EventPacket) -> None:
        """Take in all events of the next packet.

        Raises:
            ConfigError: The packet comes from a sensor of another size.
        """
        packet.require_map(self._start.shape)
        if self._now_us is None:
            self._zero_us = packet.t_start_us
        self._now_us = packet.t_end_us
        if self._now_us - self._zero_us > REBASE_DECAYS * self._decay_us:
            self._weight *= self._decay()
            self._zero_us = self._now_us
        # Scaled so that one decay serves all pixels; of a pixel's events the last one is kept.
        grown = 0.5 * np.exp((packet.t - self._zero_us) / self._decay_us)
        self._weight[packet.y, packet.x] = np.where(packet.p != self._dark, grown, -grown)

    def reset(self) -> None:
        """Return to the initial state. Time starts with the next packet."""
        self._now_us: int | None = None
        self._zero_us = 0
        self._weight = np.where(self._start > GREY, GREY, -GREY).astype(np.float32)

    def _decay(self) -> np.float32:
        elapsed_us = 0 if self._now_us is None else self._now_us - self._zero_us
        return np.float32(np.exp(-elapsed_us / self._decay_us))
