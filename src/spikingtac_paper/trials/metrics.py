"""The metrics of point tracking.

The three metrics of the paper compare the end of a recording with its beginning (section V-A). A
method that never moves its markers scores well in them. The metrics against ground truth do not
have this defect; the report shows both.
"""

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import RecordingError
from spikingtac.markers import AnchoredLaw
from spikingtac.types import FloatArray
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction

# Largest return distance of a success and smallest error of a lost marker, px (section V-A).
SUCCESS_PX = 5.0

LOST_US = 50_000  # Shortest time with a large error after which a marker counts as lost, us.


# All metrics, in the order of the tables.
POINT_METRICS: tuple[Metric, ...] = (
    Metric("success_rate", "1", "fraction of trials whose markers all end within 5 px of rest"),
    Metric("return_mean_px", "px", "last estimate: mean distance of position_px to the reference"),
    Metric("return_std_px", "px", "standard deviation over the markers of the same distances"),
    Metric("error_mean_px", "px", "mean distance of detected_px to the truth, all markers, times"),
    Metric("error_p95_px", "px", "95th percentile of the same distances, mean over the trials"),
    Metric("error_final_px", "px", "last estimate: mean distance of detected_px to the truth"),
    Metric(
        "return_error_mean_px", "px", "mean distance of detected_px to the truth after the release"
    ),
    Metric("zeroed_return_mean_px", "px", "return_mean_px under the anchored law"),
    Metric("zeroed_return_std_px", "px", "return_std_px under the anchored law"),
    Metric("lost_markers", "markers", "markers more than 5 px off for more than 50 ms", "sum"),
    Metric("id_swaps", "markers", "markers nearest another's true place for over 50 ms", "sum"),
)


def point_scores(
    prediction: Prediction,
    truth: GroundTruth,
    damaged: tuple[int, ...] = (),
) -> dict[str, float]:
    """Return every metric of one trial.

    Args:
        prediction: The estimates of the method.
        truth: The true positions.
        damaged: Broken and missing markers; they are not scored.

    Returns:
        Values by the names of :data:`POINT_METRICS`.

    Raises:
        RecordingError: The recording holds no events, so that nothing was estimated.
    """
    if not len(prediction.t_us):
        raise RecordingError("the recording holds no events, so there are no estimates to score")
    whole = np.setdiff1d(np.arange(len(prediction.reference_px)), damaged)
    reference_px = prediction.reference_px[whole]
    detected_px = prediction.detected_px[:, whole].astype(np.float64)
    true_px = truth.at(prediction.t_us)
    error_px = np.linalg.norm(detected_px - true_px[:, whole], axis=2)
    last_px = prediction.position_px[-1, whole].astype(np.float64)
    zeroed = AnchoredLaw().update(detected_px[-1], reference_px)
    given_px, zeroed_px = (
        np.linalg.norm(one - reference_px, axis=1) for one in (last_px, zeroed.astype(np.float64))
    )
    released = error_px[prediction.t_us > truth.released_us]
    away = longest_duration_us(error_px > SUCCESS_PX, prediction.t_us)
    elsewhere = longest_duration_us(nearest_another(detected_px, true_px, whole), prediction.t_us)
    return {
        "success_rate": float(given_px.max() <= SUCCESS_PX),
        "return_mean_px": float(given_px.mean()),
        "return_std_px": float(given_px.std()),
        "error_mean_px": float(error_px.mean()),
        "error_p95_px": float(np.percentile(error_px, 95)),
        "error_final_px": float(error_px[-1].mean()),
        "return_error_mean_px": float((released if len(released) else error_px[-1:]).mean()),
        "zeroed_return_mean_px": float(zeroed_px.mean()),
        "zeroed_return_std_px": float(zeroed_px.std()),
        "lost_markers": float((away > LOST_US).sum()),
        "id_swaps": float((elsewhere > LOST_US).sum()),
    }


def longest_duration_us(state: NDArray[np.bool_], t_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each marker the longest uninterrupted time in a state, us.

    Args:
        state: ``(n, m)`` True where the marker is in the state.
        t_us: ``(n,)`` times, us; a state lasts until the next one.
    """
    ends_us = np.append(t_us[1:], t_us[-1:])
    longest = np.zeros(state.shape[1], np.int64)
    for marker in np.flatnonzero(state.any(axis=0)):
        change = np.diff(state[:, marker].astype(np.int8), prepend=0, append=0)
        first, last = np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1
        longest[marker] = (ends_us[last] - t_us[first]).max()
    return longest


def nearest_another(
    detected_px: FloatArray, true_px: FloatArray, own: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Return a mask ``(n, k)`` of estimates that are nearer to another marker than to their own.

    Args:
        detected_px: ``(n, k, 2)`` estimates, px.
        true_px: ``(n, m, 2)`` true positions of all markers, px.
        own: ``(k,)`` index of the marker of each estimate.
    """
    error_px = np.linalg.norm(detected_px - true_px[:, own], axis=2)
    out = np.zeros(error_px.shape, np.bool_)
    # An estimate nearer to another marker is off by half a spacing at least: few are searched.
    for time, column in zip(*np.nonzero(error_px > SUCCESS_PX), strict=True):
        distance_px = np.linalg.norm(true_px[time] - detected_px[time, column], axis=1)
        out[time, column] = distance_px.argmin() != own[column]
    return out
