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

from dataclasses import dataclass, field, replace

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.denoiser import Denoiser
from spikingtac.errors import ConfigError
from spikingtac.markers.published.blob_tracker import BlobTracker, BlobTrackerConfig
from spikingtac.state_map.paint import paint_binary_discs
from spikingtac_paper.baselines.time_surface import TimeSurface


@dataclass(frozen=True, kw_only=True, slots=True)
class NeutacConfig:
    """The known parameters of NeuTac, and those that had to be chosen.

    Attributes:
        rate_hz: Estimates per second, Hz (300 Hz: table I of the SpikingTac paper).
        support_us: Window of the background-activity filter, us (ours; tuned).
        decay_us: Time constant of the time surface, us (tuned).
        level: Threshold on the denoised time surface; 0.5 is grey (tuned).
        blobs: Blob detection, as for the ``paper`` preset.
    """

    rate_hz: float = 300.0
    support_us: int = 5_000
    decay_us: float = 100_000_000.0
    level: float = 0.5
    blobs: BlobTrackerConfig = field(default_factory=BlobTrackerConfig)

    def __post_init__(self) -> None:
        if not self.rate_hz > 0.0 or not self.decay_us > 0.0 or not 0.0 < self.level < 1.0:
            raise ConfigError(
                f"rate_hz {self.rate_hz} and decay_us {self.decay_us} must be positive, "
                f"level {self.level} between 0 and 1"
            )


def neutac_tracker(
    config: NeutacConfig, calibration: Calibration, denoiser: Denoiser
) -> BlobTracker:
    """Assemble the published stages from those of this package, behind a filter of isolated events.

    Args:
        config: Surface and threshold.
        calibration: Rest positions of the markers; the initial surface is drawn from it.
        denoiser: Denoiser of the surface.
    """
    start = paint_binary_discs(calibration.size, calibration.reference_px, calibration.radius_px)
    surface = TimeSurface(start, config.decay_us, dark_markers=calibration.polarity == "dark")
    blobs = replace(config.blobs, threshold=config.level, support_us=config.support_us)
    return BlobTracker(blobs, calibration, denoiser, state_map=surface)
