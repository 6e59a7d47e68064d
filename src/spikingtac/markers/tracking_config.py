"""How markers are followed: the settings of every tracking method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, get_args

from spikingtac.denoise.registry import DENOISERS
from spikingtac.markers.anchored_law import AnchoredLawConfig
from spikingtac.markers.graded.tracker import GradedTrackerConfig
from spikingtac.markers.hysteresis import PaperLawConfig
from spikingtac.markers.paper import BlobTrackerConfig
from spikingtac.types import LawName


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingConfig:
    """How markers are followed; the registry says which methods there are.

    Attributes:
        method: ``disc``, ``bands`` or ``blobs``, or the name of another package's tracker.
        rare_off_method: Method for sensors whose OFF events are rare, by their calibration (an OFF
            step above 1.3 ON steps, and pixels that do not recover); empty for ``method``. Levels
            alone do not place a disc there (simulated: 0.23 px; bands 0.17).
        rate_hz: Estimates per second of data time.
        hysteresis: Law of the output position: ``none``, ``paper`` or ``anchored``.
        smooth: Whether tracks of files are smoothed backward, for ``disc`` and ``bands``.
        denoiser: For ``blobs``: a name in :data:`spikingtac.denoise.registry.DENOISERS`.
        disc: For ``disc`` and ``bands``.
        blobs: For ``blobs``.
        paper_law: For the law ``paper``.
        anchored_law: For the law ``anchored``.
        options: For a tracker from another package, which checks them itself.
    """

    method: str = "disc"
    rare_off_method: str = ""
    rate_hz: float = 1_000.0
    hysteresis: str = field(default="none", metadata={"choices": get_args(LawName)})
    smooth: bool = False
    denoiser: str = field(default="box7", metadata={"choices": tuple(DENOISERS)})
    disc: GradedTrackerConfig = field(default_factory=GradedTrackerConfig)
    blobs: BlobTrackerConfig = field(default_factory=BlobTrackerConfig)
    paper_law: PaperLawConfig = field(default_factory=PaperLawConfig)
    anchored_law: AnchoredLawConfig = field(default_factory=AnchoredLawConfig)
    options: dict[str, Any] = field(default_factory=dict, hash=False)
