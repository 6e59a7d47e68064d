"""How markers are followed: the settings of every tracking method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, get_args

from spikingtac.denoise.registry import DENOISERS
from spikingtac.markers.anchored_law import AnchoredLawConfig
from spikingtac.markers.graded.bands.band_locator import BandLocatorConfig
from spikingtac.markers.graded.centroid.centroid_locator import CentroidLocatorConfig
from spikingtac.markers.graded.disc_locator import DiscLocatorConfig
from spikingtac.markers.hysteresis import PaperLawConfig
from spikingtac.markers.maintenance_config import MaintenanceConfig
from spikingtac.markers.published.blob_tracker import BlobTrackerConfig
from spikingtac.types import LawName


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingConfig:
    """How markers are followed; the registry says which methods there are.

    Attributes:
        method: ``disc`` (which is ``bands`` where the calibration asks for it), ``bands``,
            ``centroid`` or ``blobs``, or the name of another package's tracker.
        rate_hz: Estimates per second of data time.
        hysteresis: Law of the output position: ``none``, ``paper`` or ``anchored``.
        denoiser: For ``blobs``: a name in :data:`spikingtac.denoise.registry.DENOISERS`.
        disc: For ``disc``.
        bands: For ``bands``, and for ``disc`` where the calibration asks for it.
        centroid: For ``centroid``.
        blobs: For ``blobs``.
        maintenance: For ``disc``, ``bands`` and ``centroid``.
        paper_law: For the law ``paper``.
        anchored_law: For the law ``anchored``.
        options: For a tracker from another package, which checks them itself.
    """

    method: str = "disc"
    rate_hz: float = 1_000.0
    hysteresis: str = field(default="none", metadata={"choices": get_args(LawName)})
    denoiser: str = field(default="box7", metadata={"choices": tuple(DENOISERS)})
    disc: DiscLocatorConfig = field(default_factory=DiscLocatorConfig)
    bands: BandLocatorConfig = field(default_factory=BandLocatorConfig)
    centroid: CentroidLocatorConfig = field(default_factory=CentroidLocatorConfig)
    blobs: BlobTrackerConfig = field(default_factory=BlobTrackerConfig)
    maintenance: MaintenanceConfig = field(
        default_factory=MaintenanceConfig, metadata={"former_names": ("care",)}
    )
    paper_law: PaperLawConfig = field(default_factory=PaperLawConfig)
    anchored_law: AnchoredLawConfig = field(default_factory=AnchoredLawConfig)
    options: dict[str, Any] = field(default_factory=dict, hash=False)
