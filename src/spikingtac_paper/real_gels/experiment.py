"""Every preset and baseline on recordings of real gels, of sensors like the real one, and of v2e.

Ablations run the variants of the default tracker on the same recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from spikingtac import Calibration
from spikingtac.batch import begin_run
from spikingtac.config import digest
from spikingtac.errors import ConfigError, SpikingTacError
from spikingtac.events import open_events
from spikingtac_paper.harness.report import Report, lines_of, rows_of, write_report
from spikingtac_paper.harness.run import (
    Progress,
    Record,
    RunOptions,
    code_digest,
    kept,
    provenance,
    select_methods,
)
from spikingtac_paper.point_tracking.ablation import default_variants
from spikingtac_paper.real_gels.scoring import METRICS, Plateaus, plateau_scores, truth_scores
from spikingtac_paper.trials.ground_truth import GroundTruth
from spikingtac_paper.trials.methods import Method, main_methods
from spikingtac_paper.trials.prediction import Prediction
from spikingtac_paper.trials.trial import calibration_digest, kept_calibration

NAME = "real"
OWN = ("default", "fast", "paper")  # Methods whose results stand on the first page.
QUICK_CASES = ("real-presses", "sim-presses/itself")  # Cases of a quick run.
FOLDER = "gel"  # Folder of the gels' recordings below that of the foreign recordings.

# Where the events come from: a transparent model, the simulator v2e, or a real sensor.
SIMULATED, V2E, RECORDED = "simulated", "v2e", "recorded"

# Rate at which estimates are stored and scored, Hz; a real recording lasts for minutes.
KEPT_HZ = 250.0


@dataclass(frozen=True, kw_only=True, slots=True)
class GelCase:
    """One recording and one way to calibrate its sensor.

    Attributes:
        name: Of the rows in ``report.json``.
        events: File to track.
        slides: File to calibrate from; None calibrates from :attr:`events` itself.
        truth: File with the true course of the markers, or None.
        reference: File with the standing places of the markers between the bursts, or None.
        source: Where the events come from.
    """

    name: str
    events: str
    slides: str | None = None
    truth: str | None = None
    reference: str | None = None
    source: str

    @property
    def calibrated_from(self) -> str:
        """File that the calibration is made from."""
        return self.slides or self.events

    def files(self) -> tuple[str, ...]:
        """Return every file that the case needs."""
        named = (self.events, self.slides, self.truth, self.reference)
        return tuple(name for name in named if name)

    def is_there(self, folder: Path) -> bool:
        """Return whether all files of the case are in a folder."""
        return all((folder / name).is_file() for name in self.files())


# All cases, the real recording first.
CASES = (
    GelCase(name="real-presses", events="gel/real_presses.aedat4", source=RECORDED,
            reference="gel/real_presses.reference.npz"),
    GelCase(name="sim-presses/slides", events="gel/sim_presses.raw", source=SIMULATED,
            slides="gel/sim_presses_bootstrap.raw", truth="gel/sim_presses.truth.npz"),
    GelCase(name="sim-presses/itself", events="gel/sim_presses.raw", source=SIMULATED,
            truth="gel/sim_presses.truth.npz"),
    GelCase(name="gel/slides", events="gel/gel.raw", source=V2E,
            slides="gel/gel_bootstrap.raw", truth="gel/gel.truth.npz"),
    GelCase(name="mix/slides", events="v2e/mix.raw", source=V2E,
            slides="v2e/bootstrap.raw", truth="v2e/mix.truth.npz"),
    GelCase(name="gel/itself", events="gel/gel.raw", source=V2E, truth="gel/gel.truth.npz"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class GelJob:
    """One case, and one method on it.

    Attributes:
        case: The recording.
        data: Folder of the recording.
        folder: Folder of the run.
        method: Name of the method; empty makes the calibration only.
    """

    case: GelCase
    data: Path
    folder: Path
    method: str = ""


def run(options: RunOptions) -> dict[str, Any]:
    """Run the experiment, write its report, and return a summary.

    Raises:
        ConfigError: There is no folder with the recordings, or a method is unknown.
    """
    data = _recordings(options.data)
    known = _methods(options.ablations)
    names = select_methods(known, options.methods)
    settings = {"experiment": NAME, "ablations": options.ablations, "methods": names}
    settings |= {"quick": options.quick}
    begin_run(options.output, settings, options.resume, options.overwrite)
    cases = [case for case in CASES if case.is_there(data)]
    cases = [case for case in cases if not options.quick or case.name in QUICK_CASES]
    jobs = [GelJob(case=case, data=data, folder=options.output) for case in cases]
    refused, records = _scored(jobs, names, options)
    rows = rows_of(records, METRICS)
    absent = [case.name for case in CASES if not case.is_there(data)]
    report = Report(
        experiment=NAME,
        title="Recordings of real gels",
        provenance=provenance(options.command("experiment", NAME), settings),
        rows=rows,
        findings=[
            *lines_of(rows, [case.name for case in cases], OWN),
            *(f"{case}: {why}" for case, why in refused.items()),
            *(f"{name} was not run: its files are not there" for name in absent),
        ],
        methods={name: known[name].about for name in names},
    )
    return write_report(report, options.output, trials=len(records))


def _methods(ablations: bool) -> dict[str, Method]:
    """Return the methods of the main table, or the variants of the default tracker."""
    return default_variants() if ablations else main_methods()


def _recordings(data: Path | None) -> Path:
    if data is None or not (data / FOLDER).is_dir():
        raise ConfigError(
            f"this experiment reads recordings from the folder {FOLDER}/ below SPIKINGTAC_DATA, "
            "which is not there; set the variable to the folder of your recordings"
        )
    return data


def _scored(
    jobs: Sequence[GelJob], names: Sequence[str], options: RunOptions
) -> tuple[dict[str, str], list[Record]]:
    """Calibrate each sensor once, then run every method on every case.

    Returns:
        Case -> reason of a failed calibration; the records of all other cases.
    """
    sensors = {calibration_path(job): job for job in jobs}
    progress = Progress(options, len(sensors) + len(jobs) * len(names))
    with options.pool(len(jobs) * len(names)) as pool:
        why = progress.run(pool, make_calibration, sensors.values())
        reasons = dict(zip(sensors, why, strict=True))
        refused = {
            job.case.name: f"not calibrated, {reason}"
            for job in jobs
            if (reason := reasons[calibration_path(job)])
        }
        kept_jobs = [job for job in jobs if job.case.name not in refused]
        method_jobs = [replace(job, method=name) for job in kept_jobs for name in names]
        return refused, progress.run(pool, run_method, method_jobs)


def calibration_path(job: GelJob) -> Path:
    """Return the file of a case's calibration, named by its recording and the code behind it."""
    code = code_digest()
    return job.folder / "calibrations" / f"{Path(job.case.calibrated_from).stem}-{code}.json"


def make_calibration(job: GelJob) -> str:
    """Calibrate the sensor of a case as ``spikingtac calibrate`` does without any option.

    Returns:
        The reason why that failed, or an empty text.
    """
    try:
        kept_calibration(calibration_path(job), lambda: job.data / job.case.calibrated_from)
    except SpikingTacError as error:
        return str(error)
    return ""


def run_method(job: GelJob) -> Record:
    """Track a recording with one method and score it, or read the results from disk."""
    case, method = job.case, (main_methods() | default_variants())[job.method]
    calibration = Calibration.load(calibration_path(job))
    about = {
        "calibration": calibration_digest(calibration, method.reads),
        "method": method.key(),
        "case": asdict(case),
        "kept_hz": KEPT_HZ,
    }
    key, stem = digest(about), case.name.replace("/", "-")

    def tracked() -> Prediction:
        return method.track(open_events(job.data / case.events), calibration, KEPT_HZ)

    def scored() -> Record:
        file = job.folder / "predictions" / job.method / f"{stem}.npz"
        prediction = Prediction.kept(file, key, tracked)
        trial = {"case": case.name, "groups": [], "seed": 0, "source": case.source}
        scores = _scores(job, prediction, calibration)
        return {"method": job.method, "trial": trial, "scores": scores}

    score_key = digest({"prediction": key, "code": code_digest()})
    return kept(job.folder / "scores" / job.method / f"{stem}.json", score_key, scored)


def _scores(job: GelJob, prediction: Prediction, calibration: Calibration) -> dict[str, float]:
    if job.case.truth:
        truth = GroundTruth.load(job.data / job.case.truth)
        return truth_scores(prediction, truth, calibration)
    assert job.case.reference
    plateaus = Plateaus.load(job.data / job.case.reference)
    return plateau_scores(prediction, plateaus, calibration)
