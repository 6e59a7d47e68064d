"""Track management: which markers are observed, which are coasted, and how they come back.

A marker counts as lost when its fit no longer agrees with the map, when it stays away from where
its neighbours expect it, or when it sends no events while they move. It is then predicted from
them, flagged ``coasted``, and looked for at a low rate by a detection in the full map; a detection
is taken only near the prediction and only if no other marker owns it, so that identities cannot
swap. A broken marker is never found again: it stays coasted, with confidence 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.markers.neighbours import Neighbourhood, smallest_spacing_px
from spikingtac.markers.published.associate import UNMATCHED, associate
from spikingtac.markers.published.blobs import BlobConfig, BlobDetector

SMALLEST_BLOB_SHARE = 0.4
LARGEST_BLOB_SHARE = 2.5
"""Area of a blob that may be a lost marker, over that of its disc (ours)."""

STRAIN_PITCH_PX = 36.0
"""Spacing of markers for which ``strain_px`` is meant: eight over 320 px. Where they are
farther apart, one press moves one marker and leaves its neighbours."""

BLOB_LEVEL = 0.5
"""Level at which the full-frame detection binarises the map: half-way."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackManagementConfig:
    """When a marker counts as lost.

    Attributes:
        agreement: Share of the edge that must agree with the fitted disc (ours).
        strain_px: Distance from the neighbours' prediction that is still believed, at rest, px; of
            markers farther apart than :data:`STRAIN_PITCH_PX` in proportion more.
        strain_share: The same, as a share of how far the farthest neighbour moved (ours: in torsion
            the neighbours of a marker move in opposite directions, so that their prediction says
            nothing; but no marker moves much farther than all of them).
        patience_us: How long a marker may look lost before it is coasted, us.
        search_us: Time between two full-frame detections while a marker is lost, us.
        capture_share: Largest distance between prediction and detection, as a share of the smallest
            spacing of the markers.
    """

    agreement: float = 0.35
    strain_px: float = 6.0
    strain_share: float = 1.2
    patience_us: int = 20_000
    search_us: int = 20_000
    capture_share: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 < self.agreement < 1.0:
            raise ConfigError(f"agreement is {self.agreement}, it must lie between 0 and 1")
        for name in ("strain_px", "strain_share", "capture_share"):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"{name} is {getattr(self, name)}, it must be positive")
        if self.patience_us < 0 or self.search_us < 0:
            raise ConfigError("patience_us and search_us must not be negative")


class TrackManager:
    """Keeps the identities of one sensor's markers.

    Attributes:
        neighbours: What markers say of each other.
        coasted: ``(m,)`` markers that are predicted, not observed.
        placed: Whether the last judgement placed any marker.
        moved: ``(m,)`` markers that it placed somewhere else.
        position_px: ``(m, 2)`` where it placed them.
        capture_px: Largest distance between a prediction and a detection that is taken, px.
    """

    def __init__(self, config: TrackManagementConfig, calibration: Calibration) -> None:
        """Begin with every marker observed at its reference."""
        count = len(calibration.reference_px)
        self._config = config
        self._reference_px = calibration.reference_px
        self.neighbours = Neighbourhood(calibration.reference_px)
        disc_px = np.pi * calibration.radius_px**2
        self._detector = BlobDetector(
            calibration.size,
            BlobConfig(
                threshold=BLOB_LEVEL,
                min_area_px=SMALLEST_BLOB_SHARE * float(disc_px.min()),
                max_area_px=LARGEST_BLOB_SHARE * float(disc_px.max()),
            ),
        )
        spacing_px = smallest_spacing_px(calibration.reference_px)
        self.capture_px = config.capture_share * spacing_px
        self._strain_px = config.strain_px * max(spacing_px / STRAIN_PITCH_PX, 1.0)
        self._doubted_since_us = np.full(count, -1, np.int64)
        self._search_at_us = 0
        self._doubted = np.zeros(count, np.bool_)
        self._watching = False
        self.coasted = np.zeros(count, np.bool_)
        self.placed = False
        self.moved = np.zeros(count, np.bool_)
        self.position_px = calibration.reference_px.copy()

    def judge(
        self,
        t_us: int,
        fitted_px: NDArray[np.float64],
        agreement: NDArray[np.float64],
        levels: NDArray[np.float32],
        silent: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """Decide which markers are coasted at ``t_us`` and look for those that are.

        Args:
            t_us: Time of the estimate, us.
            fitted_px: ``(m, 2)`` positions from the fit, px.
            agreement: ``(m,)`` share of each edge that agrees with its disc.
            levels: ``(height, width)`` the map.
            silent: ``(m,)`` markers that are gone
                (:mod:`spikingtac.markers.graded.missing_markers`): coasted at once, and not looked
                for while they are, since the map shows them where they were.

        Returns:
            ``(m,)`` the coasted markers (:attr:`coasted`, not a copy).
        """
        config = self._config
        clear = _all_clear_kernel(
            fitted_px,
            self._reference_px,
            self.neighbours.index,
            self.neighbours.weight,
            agreement,
            silent,
            (config.agreement, self._strain_px, config.strain_share),
            self._doubted,
        )
        if clear and not self._watching:
            return self.coasted
        self.placed = False
        self.moved[:] = False
        self._weigh(t_us)
        self.coasted |= silent
        if self.coasted.any():
            self._place_held(fitted_px)
            if t_us >= self._search_at_us:
                self._search_at_us = t_us + config.search_us
                self._search(fitted_px, levels, silent)
        self._watching = self.placed or bool(self._doubted.any() or self.coasted.any())
        return self.coasted

    def _weigh(self, t_us: int) -> None:
        doubted = self._doubted
        fresh = doubted & (self._doubted_since_us < 0)
        self._doubted_since_us[fresh] = t_us
        self._doubted_since_us[~doubted] = -1
        self.coasted |= doubted & (t_us - self._doubted_since_us >= self._config.patience_us)

    def _place_held(self, fitted_px: NDArray[np.float64]) -> None:
        coasted = self.coasted
        blended = np.where(coasted[:, np.newaxis], self.position_px, fitted_px)
        self.position_px[coasted] = self.neighbours.expected_px(blended)[coasted]
        self.moved |= coasted
        self.placed = True

    def _search(
        self,
        fitted_px: NDArray[np.float64],
        levels: NDArray[np.float32],
        silent: NDArray[np.bool_],
    ) -> None:
        blobs = self._detector.detect(levels)
        expected_px = np.where(self.coasted[:, np.newaxis], self.position_px, fitted_px)
        match = associate(expected_px, blobs.center_px, self.capture_px)
        found = self.coasted & ~silent & (match != UNMATCHED)
        self.position_px[found] = blobs.center_px[match[found]]
        self.coasted &= ~found
        self._doubted_since_us[found] = -1


@njit(cache=True, nogil=True)
def _all_clear_kernel(
    fitted_px: NDArray[np.float64],
    reference_px: NDArray[np.float64],
    neighbours: NDArray[np.int64],
    weight: NDArray[np.float64],
    agreement: NDArray[np.float64],
    silent: NDArray[np.bool_],
    limits: tuple[float, float, float],
    doubted: NDArray[np.bool_],
) -> bool:  # pragma: no cover - compiled
    """Mark what looks lost; ``limits`` are agreement, strain (px) and strain per travel.

    Returns whether nothing does, and nothing is silent.
    """
    least, strain_px, strain_share = limits
    clear = True
    for m in range(fitted_px.shape[0]):
        off_x, off_y = fitted_px[m, 0] - reference_px[m, 0], fitted_px[m, 1] - reference_px[m, 1]
        travel2 = 0.0
        for k in range(neighbours.shape[1]):
            n = neighbours[m, k]
            dx = fitted_px[n, 0] - reference_px[n, 0]
            dy = fitted_px[n, 1] - reference_px[n, 1]
            off_x -= weight[m, k] * dx
            off_y -= weight[m, k] * dy
            travel2 = max(travel2, dx * dx + dy * dy)
        strain, travel = np.hypot(off_x, off_y), np.sqrt(travel2)
        doubted[m] = agreement[m] < least or strain > strain_px + strain_share * travel
        clear = clear and not doubted[m] and not silent[m]
    return clear
