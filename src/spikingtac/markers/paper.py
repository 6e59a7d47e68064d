"""The published pipeline, one screen: map, network, blobs, k-d tree, hold, hysteresis law.

Paper sections IV-A to IV-C. Two things are ours, and can be switched off: a filter of lone events
before the map, and that the cleaned map goes back into the map now and then, so that noise cannot
gather. The error against truth is dominated by the bias of the last-polarity map
(:mod:`spikingtac.state_map.binary`), which no later stage can see: about 1 px in motion.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.denoise.classical import Denoiser
from spikingtac.events.filters import BackgroundActivityFilter
from spikingtac.events.hot_pixels import HotPixelWatch
from spikingtac.markers.blobs import UNMATCHED, associate, blob_areas_px, find_blobs
from spikingtac.markers.laws import OutputLaw
from spikingtac.markers.neighbours import smallest_spacing_px
from spikingtac.schema import require_within
from spikingtac.state_map.binary import BinaryStateMap, StateMap, paint_binary_discs
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

# OFF events are rare where each stands for so many ON events: they come alone, so that the filter
# takes them for noise. (The twin and v2e have 1.04, a simulated recorded sensor 2.8.)
RARE_OFF_RATIO = 1.5

# Window of the filter of lone events there. (On one simulated recording: 5 ms 3.1 px, 20 ms
# 1.8 px, and without a refresh 0.7 px.)
RARE_OFF_SUPPORT_US = 20_000

# Level at which the cleaned map is binarised there (0.66 px, none lost, for 0.73 px, two
# lost).
RARE_OFF_THRESHOLD = 0.6

# Association threshold as a share of the smallest distance between two resting markers: beyond one
# half a neighbour could be nearer than the marker itself.
PROXIMITY_SHARE = 0.5

# Estimates per second of the published tracker (paper, abstract and section VI).
PAPER_RATE_HZ = 350


@dataclass(frozen=True, kw_only=True, slots=True)
class BlobTrackerConfig:
    """What the paper leaves open in its front end, relative to the calibrated markers.

    Attributes:
        threshold: Level at which the cleaned map is binarised (half-way).
        support_us: Window of a background-activity filter before the map, us; 0 is none, as printed
            (nothing else keeps leak, which is always ON, from painting a map of last
            polarities white within seconds; tuned by benchmarks/tune_baselines.py).
        refresh_us: Time after which the cleaned, binarised map replaces the map, us; 0 is never, as
            printed (a map of last polarities forgets nothing, so that noise fills it: at 5
            Hz/px every fifth marker is lost after some seconds).
    """

    threshold: float = field(default=0.5, metadata={"range": (0.05, 0.95)})
    support_us: int = field(default=5_000, metadata={"range": (0, 100_000)})
    refresh_us: int = field(default=100_000, metadata={"range": (0, 1_000_000)})

    def __post_init__(self) -> None:
        require_within(self, threshold=(1e-3, 1.0), support_us=(0, 1e9), refresh_us=(0, 1e9))


class BlobTracker:
    """Follows markers by detecting blobs in the state map, as published.

    A marker without a blob of its own keeps its last position (zero-order hold) and is flagged
    ``coasted`` with confidence 0; otherwise the confidence is the ratio of its blob's area to that
    of its calibrated disc, or the inverse where that is smaller.
    """

    def __init__(
        self,
        config: BlobTrackerConfig,
        calibration: Calibration,
        denoiser: Denoiser,
        state_map: StateMap | None = None,
        law: OutputLaw | None = None,
    ) -> None:
        """Assemble the tracker; nothing is computed yet.

        Args:
            config: What the paper leaves open.
            calibration: Where the markers rest; their map is painted from it.
            denoiser: Cleans the map before it is binarised (section IV-B).
            state_map: The map to use; None is the paper's binary map, painted. Only a binary map
                may be refreshed.
            law: From detected to given position; None gives out what was detected.
        """
        self._config = config = _adapted(config, calibration)
        self._calibration, self._denoiser, self._law = calibration, denoiser, law or OutputLaw()
        self._map = state_map or painted_binary_map(calibration)
        self._disc_area_px: FloatArray = np.pi * calibration.radius_px**2
        self._areas_px = blob_areas_px(calibration.radius_px)
        self._proximity_px = PROXIMITY_SHARE * smallest_spacing_px(calibration.reference_px)
        self._start()

    def absorb(self, packet: EventPacket) -> None:
        """Take in every event of the next stretch of time (section IV-A, Eq. 1).

        Raises:
            ConfigError: The recording comes from a sensor of another size.
        """
        packet = self._hot.kept(packet)
        self._map.absorb(packet if self._filter is None else self._filter(packet))

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return the markers at ``t_us``, the end of what was absorbed (sections IV-B and IV-C)."""
        cleaned = self._denoiser.clean(self._map.values)
        blobs = find_blobs(cleaned, self._config.threshold, self._areas_px)
        self._refresh(t_us, cleaned)
        match = associate(self._detected_px, blobs.center_px, self._proximity_px)
        found = match != UNMATCHED
        self._detected_px[found] = blobs.center_px[match[found]]  # the others: zero-order hold
        confidence, share = np.zeros(len(match)), blobs.area_px[match[found]]
        share = share / self._disc_area_px[found]
        confidence[found] = np.minimum(share, 1.0 / share)
        reference_px = self._calibration.reference_px
        position_px = self._law.update(self._detected_px, reference_px)
        places = self._detected_px.copy(), position_px, position_px - reference_px
        return MarkerFrame(t_us, *places, ~found, confidence)

    def reset(self) -> None:
        """Forget everything but the calibration: the markers rest, the map is as painted."""
        self._map.reset()
        self._law.reset()
        self._start()

    @property
    def state_map(self) -> StateMap:
        """The map as it stands; to be read, for a display or a picture, and not changed."""
        return self._map

    @property
    def hot_pixels(self) -> int:
        """How many pixels became hot meanwhile; their events are ignored."""
        return self._hot.found

    def _start(self) -> None:
        size, support_us = self._calibration.size, self._config.support_us
        self._hot = HotPixelWatch(self._calibration.hot_px, size)
        self._detected_px = self._calibration.reference_px.astype(np.float64)
        self._refreshed_us: int | None = None
        self._filter: BackgroundActivityFilter | None = None
        if support_us:
            self._filter = BackgroundActivityFilter(size, support_us)

    def _refresh(self, t_us: int, cleaned: NDArray[np.float32]) -> None:
        """Write the cleaned map back; a map that was just painted needs no mending."""
        if self._refreshed_us is None:
            self._refreshed_us = t_us
        if not self._config.refresh_us or t_us - self._refreshed_us < self._config.refresh_us:
            return
        self._refreshed_us = t_us
        self._map.values[:] = cleaned >= self._config.threshold


def _adapted(config: BlobTrackerConfig, calibration: Calibration) -> BlobTrackerConfig:
    """Return what suits a sensor whose OFF events are rare: their filter waits, no refresh."""
    on, off = calibration.step_on, calibration.step_off
    if on is None or off is None or off < RARE_OFF_RATIO * on:
        return config
    support_us = max(config.support_us, RARE_OFF_SUPPORT_US) if config.support_us else 0
    threshold = max(config.threshold, RARE_OFF_THRESHOLD)
    return replace(config, support_us=support_us, refresh_us=0, threshold=threshold)


def painted_binary_map(calibration: Calibration) -> BinaryStateMap:
    """Return the binary map of a sensor at rest, ready to absorb events of its polarity."""
    start = paint_binary_discs(calibration.size, calibration.reference_px, calibration.radius_px)
    return BinaryStateMap(calibration.size, start, dark_markers=calibration.polarity == "dark")
