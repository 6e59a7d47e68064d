"""``spikingtac calibrate --check``: whether recordings come from the sensor of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spikingtac.cli.calibrate_args import Args
from spikingtac.cli.many import means_many, require_folder, run_many
from spikingtac.cli.messages import emit_json, progress, remark

EXIT_FOREIGN = 1
"""The input is at fault: it does not fit the calibration."""


def run_check(args: Args, calibration: Path) -> int:
    """Check one recording, or many into a folder; 1 where one does not fit."""
    if means_many(args, args.recordings):
        return _check_many(args, calibration)
    recording = args.recordings[0]
    with progress(f"checking {recording.name}"):
        found = _checked(_settings(args, calibration), recording)
    if args.json:
        emit_json(found)
    else:
        fit = f"{found['contradiction']:.1%} of the pixels contradict, at most {found['limit']:.0%}"
        remark(found["words"] or f"{recording.name} fits {calibration.name}: {fit}")
    return 0 if found["fits"] else EXIT_FOREIGN


def _check_many(args: Args, calibration: Path) -> int:
    from spikingtac.batch.inputs import find_recordings
    from spikingtac.batch.run import Batch
    from spikingtac.calibration.sensor_calibration import Calibration

    folder = require_folder(args.output, "calibrate --check")
    Calibration.load(calibration)  # what is wrong for all of them is refused before any work
    batch = Batch(
        name="calibrate --check",
        work=check_one,
        recordings=find_recordings(args.recordings, apart_from=folder),
        folder=folder,
        ending=".json",
        settings=_settings(args, calibration),
    )
    return run_many(batch, args)


def _settings(args: Args, calibration: Path) -> dict[str, Any]:
    return {
        "calibration": str(calibration.absolute()),
        "sensor": args.sensor,
        "strict": args.strict,
    }


def check_one(settings: Mapping[str, Any], recording: Path, output: Path) -> dict[str, Any]:
    """Check one of many recordings, write what was found, and return its row of the table."""
    from spikingtac.atomic_files import write_json

    found = _checked(settings, recording)
    write_json(output, found)
    return {
        "fits": int(found["fits"]),
        "contradiction": found["contradiction"],
        "limit": found["limit"],
    }


def _checked(settings: Mapping[str, Any], recording: Path) -> dict[str, Any]:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.events.open import open_events
    from spikingtac.markers.calibration_check import CalibrationCheck
    from spikingtac.pipeline.track import require_same_size

    calibration = Calibration.load(Path(settings["calibration"]))
    source = open_events(recording, strict=settings["strict"], sensor=settings["sensor"])
    require_same_size(source.size, calibration.size)
    check = CalibrationCheck(calibration)
    for packet in source:
        check.absorb(packet)
        if check.ended:
            break
    check.finish()
    return {
        "recording": recording.name,
        "fits": not check.foreign,
        "contradiction": float(check.contradiction),
        "limit": float(check.limit),
        "words": check.words() if check.foreign else "",
    }
