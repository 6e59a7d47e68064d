"""Errors of a tracker on a recording of a gel: against truth, or against its standing places."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from spikingtac import Calibration
from spikingtac.errors import RecordingError
from spikingtac.markers import smallest_spacing_px
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.metrics import LOST_US, SUCCESS_PX, longest_duration_us
from spikingtac_paper.trials.prediction import Prediction

# Index of the first standing place that is scored: before it the reference is not good enough (it
# closes to 0.2 to 0.5 px from the third contact on).
FIRST_PLATEAU = 4

SETTLE_US = 300_000  # Time after a burst in which the gel still creeps visibly; it is left out.

# What is reported, in the order of the columns.
METRICS: tuple[Metric, ...] = (
    Metric("error_mean_px", "px", "mean distance of detected_px to the truth, all markers, times"),
    Metric("error_p95_px", "px", "95th percentile of the same distances"),
    Metric("error_max_px", "px", "largest of the same distances"),
    Metric("pressed_mean_px", "px", "mean distance of the displacement to the reference's, pressed "
           "plateaus from the fifth standing place on"),
    Metric("released_mean_px", "px", "the same at the plateaus without contact"),
    Metric("plateau_max_px", "px", "largest of these distances, pressed or not"),
    Metric("return_median_px", "px", "marker that returns worst: median over the plateaus without "
           "contact of the distance of its estimate to its calibrated rest"),
    Metric("rest_mean_px", "px", "mean distance of the calibrated rests to the true ones"),
    Metric("rest_max_px", "px", "largest distance of a calibrated rest to the true one"),
    Metric("missing_markers", "markers", "true markers that the calibration has not", "sum"),
    Metric("lost_markers", "markers", "markers more than 5 px off for more than 50 ms", "sum"),
)  # fmt: skip

TRUTH_METRICS = ("error_mean_px", "error_p95_px", "error_max_px", "lost_markers",
                 "rest_mean_px", "rest_max_px", "missing_markers")  # fmt: skip
PLATEAU_METRICS = ("pressed_mean_px", "released_mean_px", "plateau_max_px", "return_median_px",
                   "lost_markers", "missing_markers")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Plateaus:
    """Where the markers of a recording stand between its bursts of events.

    Attributes:
        start_us: ``(k,)`` begin of each plateau, us from the first event.
        end_us: ``(k,)`` end of each plateau, us from the first event; -1 is the recording's end.
        place_px: ``(m, k, 2)`` standing places, px.
        rest_px: ``(m, 2)`` places without contact, px.
    """

    start_us: NDArray[np.int64]
    end_us: NDArray[np.int64]
    place_px: NDArray[np.float64]
    rest_px: NDArray[np.float64]

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a reference file with ``burst_us``, ``plateau_px`` and ``rest_px``.

        Raises:
            RecordingError: The file is missing, damaged, or lacks a column.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                burst_us = archive["burst_us"].astype(np.int64)
                place_px, rest_px = archive["plateau_px"], archive["rest_px"]
        except (OSError, ValueError, EOFError, KeyError) as error:
            raise RecordingError(f"{str(path)!r} holds no standing places ({error})") from error
        return cls(
            start_us=np.append(0, burst_us[:, 1]),
            end_us=np.append(burst_us[:, 0], -1),
            place_px=place_px.astype(np.float64),
            rest_px=rest_px.astype(np.float64),
        )

    def displacement_px(self) -> NDArray[np.float64]:
        """Return ``(m, k, 2)`` displacements from rest, px."""
        return self.place_px - self.rest_px[:, None]

    @property
    def pressed(self) -> NDArray[np.bool_]:
        """``(k,)`` True where something presses: every second plateau, the first one is free."""
        return np.arange(len(self.start_us)) % 2 == 1


def matched(
    calibrated_px: NDArray[np.float64], true_px: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which calibrated marker is which true one, where they lie within half a pitch.

    Args:
        calibrated_px: ``(n, 2)`` rests of the calibration, px.
        true_px: ``(m, 2)`` true rests, px.

    Returns:
        Indices of the calibrated markers, and those of the true ones, in pairs.
    """
    distance_px = np.linalg.norm(calibrated_px[:, None] - true_px[None], axis=2)
    own, other = linear_sum_assignment(distance_px)
    near = distance_px[own, other] < 0.5 * smallest_spacing_px(true_px)
    return own[near], other[near]


def truth_scores(
    prediction: Prediction, truth: GroundTruth, calibration: Calibration
) -> dict[str, float]:
    """Return the errors against the truth.

    Raises:
        RecordingError: Nothing was estimated, or no marker of the calibration is a true one.
    """
    own, other = _pairs(prediction, calibration, truth.reference_px)
    true_px = truth.at(prediction.t_us)[:, other]
    error_px = np.linalg.norm(prediction.detected_px[:, own] - true_px, axis=2)
    rest_px = np.linalg.norm(calibration.reference_px[own] - truth.reference_px[other], axis=1)
    away = longest_duration_us(error_px > SUCCESS_PX, prediction.t_us)
    missing = len(truth.reference_px) - len(own)
    return {
        "error_mean_px": float(error_px.mean()),
        "error_p95_px": float(np.percentile(error_px, 95)),
        "error_max_px": float(error_px.max()),
        "lost_markers": float((away > LOST_US).sum()),
        "rest_mean_px": float(rest_px.mean()),
        "rest_max_px": float(rest_px.max()),
        "missing_markers": float(missing),
    }


def plateau_scores(
    prediction: Prediction, plateaus: Plateaus, calibration: Calibration
) -> dict[str, float]:
    """Return the errors of the displacement at the standing places.

    Raises:
        RecordingError: Nothing was estimated, or no marker of the calibration is a known one.
    """
    own, other = _pairs(prediction, calibration, plateaus.rest_px)
    moved_px = standing_px(prediction, plateaus)[own] - calibration.reference_px[own][:, None]
    error_px = np.linalg.norm(moved_px - plateaus.displacement_px()[other], axis=2)
    scored = np.arange(len(plateaus.start_us)) >= FIRST_PLATEAU
    pressed, free = scored & plateaus.pressed, scored & ~plateaus.pressed
    returned_px = np.linalg.norm(moved_px[:, free], axis=2)
    return {
        "pressed_mean_px": float(error_px[:, pressed].mean()),
        "released_mean_px": float(error_px[:, free].mean()),
        "plateau_max_px": float(error_px[:, scored].max()),
        "return_median_px": float(np.median(returned_px, axis=1).max()),
        "lost_markers": float((error_px[:, scored] > SUCCESS_PX).any(axis=1).sum()),
        "missing_markers": float(len(plateaus.rest_px) - len(own)),
    }


def standing_px(prediction: Prediction, plateaus: Plateaus) -> NDArray[np.float64]:
    """Return ``(m, k, 2)`` median estimates over each plateau, after the gel has settled, px."""
    t_us = prediction.t_us - prediction.t_us[0]
    last_us = int(t_us[-1]) + 1
    places = []
    for start_us, end_us in zip(plateaus.start_us, plateaus.end_us, strict=True):
        until_us = last_us if end_us < 0 else int(end_us)
        inside = (t_us >= min(start_us + SETTLE_US, until_us - SETTLE_US)) & (t_us < until_us)
        places.append(np.median(prediction.detected_px[inside], axis=0))
    return np.stack(places, axis=1).astype(np.float64)


def _pairs(
    prediction: Prediction, calibration: Calibration, true_px: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    if not len(prediction.t_us):
        raise RecordingError("the recording holds no events, so nothing was estimated")
    own, other = matched(calibration.reference_px, true_px)
    if not len(own):
        raise RecordingError("no marker of the calibration is near a known one")
    return own, other
