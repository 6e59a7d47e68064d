"""Every preset and baseline on recordings of real gels, of sensors like the real one, and of v2e.

Ablations run the variants of the default tracker on the same recordings. Errors are those against
the truth, or against the places where a gel's markers stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from spikingtac import Calibration
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events import load_arrays
from spikingtac.markers import smallest_spacing_px
from spikingtac.types import FloatArray
from spikingtac_paper.harness.report import Metric, Report, lines_of, rows_of, write_report
from spikingtac_paper.harness.run import RunOptions, select_methods
from spikingtac_paper.point_tracking.ablation import default_variants
from spikingtac_paper.trials.methods import main_methods
from spikingtac_paper.trials.metrics import LOST_US, SUCCESS_PX, longest_duration_us
from spikingtac_paper.trials.runner import TrialJob, run_all
from spikingtac_paper.trials.trajectories import GroundTruth, Prediction
from spikingtac_paper.trials.trial import RecordedTrial

NAME = "real"
OWN = ("default", "fast", "paper")  # Methods whose results stand on the first page.
QUICK_CASES = ("real-presses", "sim-presses/itself")  # Cases of a quick run.
FOLDER = "gel"  # Folder of the gels' recordings below that of the foreign recordings.
TRUTH_ENDING = ".truth.npz"  # Of a file with the course of the markers, not their standing places.

# Rate at which estimates are stored and scored, Hz; a real recording lasts for minutes.
KEPT_HZ = 250.0


# All cases, the real recording first: case, source, file, slides, truth or standing places.
TRIALS = tuple(
    RecordedTrial(case=case, source=source, events=events, slides_from=slides, reference=reference)
    for case, source, events, slides, reference in (
        ("real-presses", "recorded", "gel/real_presses.aedat4", None,
         "gel/real_presses.reference.npz"),
        ("sim-presses/slides", "simulated", "gel/sim_presses.raw",
         "gel/sim_presses_bootstrap.raw", "gel/sim_presses.truth.npz"),
        ("sim-presses/itself", "simulated", "gel/sim_presses.raw", None,
         "gel/sim_presses.truth.npz"),
        ("gel/slides", "v2e", "gel/gel.raw", "gel/gel_bootstrap.raw", "gel/gel.truth.npz"),
        ("mix/slides", "v2e", "v2e/mix.raw", "v2e/bootstrap.raw", "v2e/mix.truth.npz"),
        ("gel/itself", "v2e", "gel/gel.raw", None, "gel/gel.truth.npz"),
    )
)  # fmt: skip

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


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary.

    Raises:
        ConfigError: There is no folder with the recordings, or a method is unknown.
    """
    if options.data is None or not (options.data / FOLDER).is_dir():
        raise ConfigError(
            f"this experiment reads recordings from the folder {FOLDER}/ below SPIKINGTAC_DATA, "
            "which is not there; set the variable to the folder of your recordings"
        )
    table = default_variants if options.ablations else main_methods
    known = table()
    names = select_methods(known, options.methods)
    settings = options.begin(experiment=NAME, ablations=options.ablations, methods=names)
    there = [trial for trial in TRIALS if trial.is_there(options.data)]
    chosen = [trial for trial in there if not options.quick or trial.case in QUICK_CASES]
    common = {"methods": tuple(names), "table": table, "folder": options.output}
    common |= {"data": options.data, "score": gel_scores, "kept_hz": KEPT_HZ}
    jobs = [TrialJob(trial=trial, **common) for trial in chosen]
    refused: dict[str, str] = {}
    records = run_all(jobs, options, refused)
    rows = rows_of(records, METRICS)
    report = Report(
        title="Recordings of real gels",
        settings=settings,
        rows=rows,
        findings=[
            *lines_of(rows, [trial.case for trial in chosen], OWN),
            *(f"{case}: {why}" for case, why in refused.items()),
            *(
                f"{one.case} was not run: its files are not there"
                for one in TRIALS
                if one not in there
            ),
        ],
        methods={name: known[name].about for name in names},
    )
    return write_report(report, options, trials=len(records))


def gel_scores(
    prediction: Prediction, reference: Path, calibration: Calibration, trial: RecordedTrial
) -> dict[str, float]:
    """Return the errors against a file with the truth or with the standing places."""
    del trial
    if reference.name.endswith(TRUTH_ENDING):
        return truth_scores(prediction, GroundTruth.load(reference), calibration)
    return plateau_scores(prediction, Plateaus.load(reference), calibration)


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
    place_px: FloatArray
    rest_px: FloatArray

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a reference file with ``burst_us``, ``plateau_px`` and ``rest_px``.

        Raises:
            RecordingError: The file is missing, damaged, or lacks a column.
        """
        found = load_arrays(path, "standing places", only=("burst_us", "plateau_px", "rest_px"))
        first_us, last_us = found["burst_us"].astype(np.int64).T
        places = (found[name].astype(np.float64) for name in ("plateau_px", "rest_px"))
        return cls(np.append(0, last_us), np.append(first_us, -1), *places)


def matched(
    calibrated_px: FloatArray, true_px: FloatArray
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
    true_px = plateaus.place_px - plateaus.rest_px[:, None]
    error_px = np.linalg.norm(moved_px - true_px[other], axis=2)
    number = np.arange(len(plateaus.start_us))
    # Something presses at every second plateau; the first one is free.
    scored, presses = number >= FIRST_PLATEAU, number % 2 == 1
    pressed, free = scored & presses, scored & ~presses
    returned_px = np.linalg.norm(moved_px[:, free], axis=2)
    return {
        "pressed_mean_px": float(error_px[:, pressed].mean()),
        "released_mean_px": float(error_px[:, free].mean()),
        "plateau_max_px": float(error_px[:, scored].max()),
        "return_median_px": float(np.median(returned_px, axis=1).max()),
        "lost_markers": float((error_px[:, scored] > SUCCESS_PX).any(axis=1).sum()),
        "missing_markers": float(len(plateaus.rest_px) - len(own)),
    }


def standing_px(prediction: Prediction, plateaus: Plateaus) -> FloatArray:
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
    prediction: Prediction, calibration: Calibration, true_px: FloatArray
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    if not len(prediction.t_us):
        raise RecordingError("the recording holds no events, so nothing was estimated")
    own, other = matched(calibration.reference_px, true_px)
    if not len(own):
        raise RecordingError("no marker of the calibration is near a known one")
    return own, other
