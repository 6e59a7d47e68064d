"""NeuTac's tracker: clean the surface, detect, associate; no gain law.

Source: the description in the SpikingTac paper (section V-A) of NeuTac's denoising-based detection;
its code is not public, and neither is the loss of its network.

Re-derived: continuous event time surface -> denoiser -> threshold -> blobs -> association, anew in
every frame; a marker without a blob keeps its last place. The surface fades to grey over a time
constant that nobody prints: it was tuned on separate training scenes
(``benchmarks/tune_baselines.py``), as was the level of the threshold.

What differs: a background-activity filter goes first, without which leak and noise paint either map
white within seconds and nothing is found any more. The denoiser is the one that this package's
``paper`` preset uses, so that both pipelines are compared by their surfaces and laws and not by
their networks. On the last-polarity map the same pipeline is that preset without its law, which the
experiment shows as ``neutac-binary``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from spikingtac.baselines.time_surface import TimeSurface
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.denoiser import Denoiser
from spikingtac.errors import ConfigError
from spikingtac.markers.published.blob_tracker import BlobTracker, BlobTrackerConfig
from spikingtac.state_map.paint import paint_binary_discs


@dataclass(frozen=True, kw_only=True, slots=True)
class NeutacConfig:
    """What is known of NeuTac, and what had to be chosen.

    Attributes:
        rate_hz: Estimates per second (300 Hz: table I of the SpikingTac paper).
        support_us: Window of the background-activity filter, us (ours; tuned).
        decay_us: τ of the time surface, us (tuned).
        level: Threshold on the cleaned time surface, 0.5 being grey (tuned).
        blobs: What counts as a marker's blob; as for the ``paper`` preset.
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
    """Assemble the published stages, behind a filter of lone events, from the package's own.

    Args:
        config: Surface and threshold.
        calibration: Where the markers rest; the surface is painted from it.
        denoiser: Cleans the surface.
    """
    start = paint_binary_discs(calibration.size, calibration.reference_px, calibration.radius_px)
    surface = TimeSurface(start, config.decay_us, dark_markers=calibration.polarity == "dark")
    blobs = replace(config.blobs, threshold=config.level, support_us=config.support_us)
    return BlobTracker(blobs, calibration, denoiser, state_map=surface)
