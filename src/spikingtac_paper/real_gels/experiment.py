"""Every preset and baseline on recordings of real gels, and of sensors like the real one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from spikingtac.batch.run_folder import begin_run
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import ConfigError
from spikingtac.events.open import open_events
from spikingtac.events.transform import time_slice
from spikingtac.types import EventPacket
from spikingtac_paper.harness.fingerprint import provenance
from spikingtac_paper.harness.report import Report, Table, find_row
from spikingtac_paper.harness.report_files import write_report
from spikingtac_paper.harness.rows import Row, rows_of
from spikingtac_paper.harness.run_options import RunOptions, select_methods
from spikingtac_paper.real_gels.cases import CASES, FOLDER, GelCase
from spikingtac_paper.real_gels.figures import course_figure, plateau_figure
from spikingtac_paper.real_gels.jobs import (
    GelJob,
    calibration_path,
    make_calibration,
    prediction_path,
    run_method,
)
from spikingtac_paper.real_gels.scoring import (
    METRICS,
    PLATEAU_METRICS,
    TRUTH_METRICS,
    Plateaus,
)
from spikingtac_paper.trials.methods import main_methods
from spikingtac_paper.trials.prediction import Prediction

NAME = "real"
OWN = ("default", "fast", "paper")
"""Methods whose results are stated in sentences and drawn."""

DRAWN_PLATEAU = 5
"""Plateau of the picture: a press late enough for a good reference."""

QUICK_CASES = ("real-presses", "sim-presses/itself")
"""Cases of a quick run."""


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary.

    Raises:
        ConfigError: There is no folder with the recordings, or a method is unknown.
    """
    data = _recordings(options.data)
    names = select_methods(main_methods(), options.methods)
    settings = {"experiment": NAME, "quick": options.quick, "methods": names}
    begin_run(options.output, settings, options.resume, options.overwrite)
    cases = [case for case in CASES if case.is_there(data)]
    cases = [case for case in cases if not options.quick or case.name in QUICK_CASES]
    jobs = [GelJob(case=case, data=data, folder=options.output) for case in cases]
    refused, records = _scored(jobs, names, options)
    rows = rows_of(records, METRICS, {}, paper_case="")
    absent = [case.name for case in CASES if not case.is_there(data)]
    report = Report(
        experiment=NAME,
        title="Recordings of real gels",
        provenance=provenance(options.command(NAME), settings),
        rows=rows,
        findings=[*findings(rows, cases), *(f"{case}: {why}" for case, why in refused.items()),
                  *(f"{name} was not run: its files are not in {FOLDER}/" for name in absent)],
        tables=[_table(case, names) for case in cases],
        figures=_figures([job for job in jobs if job.case.name not in refused], names),
        methods={name: method.about for name, method in main_methods().items() if name in names},
    )  # fmt: skip
    return write_report(report, options.output, trials=len(records))


def _recordings(data: Path | None) -> Path:
    if data is None or not (data / FOLDER).is_dir():
        raise ConfigError(
            f"this experiment reads recordings from the folder {FOLDER}/ below SPIKINGTAC_DATA, "
            "which is not there; set the variable to the folder of your recordings"
        )
    return data / FOLDER


def _scored(
    jobs: Sequence[GelJob], names: Sequence[str], options: RunOptions
) -> tuple[dict[str, str], list[dict[str, Any]]]:
    """Calibrate each sensor once, then run every method on every case.

    Returns:
        Case -> reason of a failed calibration; the records of all other cases.
    """
    with options.pool(len(jobs) * len(names)) as pool:
        sensors = {calibration_path(job): job for job in jobs}
        reasons = dict(zip(sensors, pool.map(make_calibration, sensors.values()), strict=True))
        refused = {job.case.name: f"not calibrated, {why}" for job in jobs
                   if (why := reasons[calibration_path(job)])}  # fmt: skip
        method_jobs = [
            GelJob(case=job.case, data=job.data, folder=job.folder, method=name)
            for job in jobs
            if job.case.name not in refused
            for name in names
        ]
        records = []
        for record in pool.map(run_method, method_jobs):
            records.append(record)
            options.report_progress(len(records), len(method_jobs))
    return refused, records


def findings(rows: Sequence[Row], cases: Sequence[GelCase]) -> list[str]:
    """Return the findings: sentences that are computed from the rows alone."""
    sentences = []
    for case in cases:
        names = PLATEAU_METRICS if case.reference else TRUTH_METRICS[:4]
        for method in OWN:
            found = [find_row(rows, method, case.name, name) for name in names]
            figures = [
                f"{row.metric} {row.value:.3g}" for row in found if row and row.value is not None
            ]
            if figures:
                line = ", ".join(figures)
                sentences.append(f"{case.name} ({case.source}), {method}: {line}.")
    return sentences


def _table(case: GelCase, names: Sequence[str]) -> Table:
    return Table.of_case(case.name, PLATEAU_METRICS if case.reference else TRUTH_METRICS, names)


def _figures(jobs: Sequence[GelJob], names: Sequence[str]) -> list[tuple[str, str]]:
    figures = []
    for job in jobs:
        if not job.case.reference:
            continue
        plateaus = Plateaus.load(job.data / job.case.reference)
        known = {name: _prediction(job, name) for name in OWN if name in names}
        predictions = {name: one for name, one in known.items() if one is not None}
        if not predictions:
            continue
        first = next(iter(predictions))
        calibration = Calibration.load(calibration_path(job))
        figures.append((
            f"{job.case.name} ({job.case.source}): events of a press, the standing places of the "
            f"independent reference (circles), and the displacements by {first} (arrows).",
            plateau_figure(predictions[first], plateaus, calibration.radius_px,
                           _burst(job, plateaus), DRAWN_PLATEAU),
        ))  # fmt: skip
        figures.append((
            f"{job.case.name} ({job.case.source}): displacement of the marker that moves most.",
            course_figure(predictions, plateaus, OWN),
        ))  # fmt: skip
    return figures


def _prediction(job: GelJob, name: str) -> Prediction | None:
    method_job = GelJob(case=job.case, data=job.data, folder=job.folder, method=name)
    return Prediction.load(prediction_path(method_job))


def _burst(job: GelJob, plateaus: Plateaus) -> EventPacket:
    source = open_events(job.data / job.case.events)
    packets = iter(source)
    first = next(packet for packet in packets if len(packet))
    start_us = int(first.t[0] + plateaus.end_us[DRAWN_PLATEAU - 1])
    end_us = int(first.t[0] + plateaus.start_us[DRAWN_PLATEAU])
    return EventPacket.concatenate(
        list(time_slice(open_events(job.data / job.case.events), start_us, end_us))
    )
