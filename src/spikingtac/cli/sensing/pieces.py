"""``spikingtac track --cut-s``: one long recording, tracked in pieces by several workers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spikingtac.cli.messages import remark
from spikingtac.cli.sensing.track_args import Args, configured, force_of
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.events.formats.file_source import FileSource
    from spikingtac.pipeline.pieces.plan import PlanPass
    from spikingtac.pipeline.pieces.tracking import Pieced

WORK = "spikingtac.cli.sensing.pieces:track_one_piece"
"""What a worker calls for each piece."""
PIECES = ".pieces"
"""Ending of the folder beside the output that holds the pieces while they are made."""


def track_in_pieces(
    args: Args, settings: Mapping[str, Any], output: Path, advance: Callable[[float], None]
) -> dict[str, Any]:
    """Track a recording in pieces and write the tracks; return the summary of the verb.

    Args:
        args: The verb's.
        settings: What a worker needs to know, as for many recordings.
        output: The file to write.
        advance: Told the share that is done.

    Raises:
        ConfigError: The recording cannot be cut, or an option does not go with it.
    """
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.cli.many import PoolRunner
    from spikingtac.events.open import open_events
    from spikingtac.pipeline.pieces.plan import PlanPass
    from spikingtac.pipeline.pieces.tracking import PieceWork, remove_pieces, track_pieces
    from spikingtac.pipeline.recording_tracks import force_estimator, require_same_size

    recording = _cuttable(args)
    calibration = Calibration.load(args.calibration)
    source = open_events(recording, strict=args.strict, sensor=args.sensor)
    require_same_size(source.size, calibration.size)
    assert args.cut_s is not None
    plan = PlanPass(source, args.cut_s)
    force = force_of(args)
    if force is not None:  # refused before any work is done
        force_estimator(force, output, len(calibration.reference_px))
    work = PieceWork(
        work=WORK,
        recording=recording.absolute(),
        folder=output.with_name(output.name + PIECES),
        settings={**settings, "cut_s": args.cut_s, "force": None},  # forces are told at the end
    )
    digest = _digest_of(source.path)
    try:
        found = track_pieces(work, plan, PoolRunner(args), args.resume, advance)
    except KeyboardInterrupt:
        remark("interrupted; what is done is kept, go on with the same command and --resume")
        raise
    summary = _write(args, source, output, found, plan, digest.result())
    remove_pieces(work.folder)
    return summary


def _cuttable(args: Args) -> Path:
    from spikingtac.batch.inputs import is_many
    from spikingtac.events.address import is_address
    from spikingtac.events.formats.evt.raw_stream import is_stream

    recording = args.recordings[0]
    if is_many(args.recordings):
        raise ConfigError("--cut-s cuts one recording; several keep the workers busy without it")
    if is_address(recording) or is_stream(recording):
        raise ConfigError(f"{str(recording)!r} is a live source; --cut-s takes a recording on disk")
    return recording


def _digest_of(recording: Path) -> Future[str | None]:
    """Compute the recording's digest beside the tracking: at the end every core would wait."""
    from spikingtac.pipeline.recording_tracks import file_digest

    digest: Future[str | None] = Future()

    def compute() -> None:
        try:
            digest.set_result(file_digest(recording))
        except OSError as error:
            digest.set_exception(error)

    threading.Thread(target=compute, name="digest", daemon=True).start()
    return digest


def _write(
    args: Args, source: FileSource, output: Path, found: Pieced, plan: PlanPass, digest: str | None
) -> dict[str, Any]:
    """Join the pieces into the tracks of the verb."""
    from spikingtac.markers.registry import make_law
    from spikingtac.pipeline.pieces.join import join
    from spikingtac.pipeline.recording_tracks import provenance_of

    tracking, calibration = configured(args, args.calibration)
    health = plan.health()
    law = None if tracking.hysteresis == "none" else make_law(tracking)
    seams = _seams(found)
    meta = {
        **provenance_of(source, tracking, digest),
        **calibration.scale(),
        "health": health,
        "calibration_misfit": found.misfit,
        "seams": {**seams, "cuts_us": list(found.cuts_us)},
    }
    force = force_of(args)
    joined = join(found.stretches, output, calibration, law, meta, force)
    markers = len(joined.coasted)
    return {
        "markers": markers,
        "estimates": joined.estimates,
        "held_share": float(joined.coasted.sum() / max(joined.estimates * markers, 1)),
        "displacement_max_px": joined.largest_px,
        "never_observed": np.flatnonzero(joined.coasted == joined.estimates).tolist(),
        "rate_hz": tracking.rate_hz,
        "anomalies": dict(source.losses.kinds()),
        "health": health,
        "calibration_misfit": found.misfit,
        "output": str(output),
        **seams,
        "kept": found.kept,
    }


def _seams(found: Pieced) -> dict[str, Any]:
    return {
        "pieces": len(found.seams) + 1,
        "mended": found.mended,
        "seam_mean_px": float(np.mean([s.mean_px for s in found.seams])) if found.seams else 0.0,
        "seam_worst_px": max((s.worst_px for s in found.seams), default=0.0),
    }


def track_one_piece(settings: Mapping[str, Any], recording: Path, output: Path) -> dict[str, Any]:
    """Track one piece, or mend it, and return what the others need to know."""
    from spikingtac.events.open import open_events
    from spikingtac.pipeline.pieces.piece import PieceTracking, mend_piece, track_piece
    from spikingtac.pipeline.pieces.plan import Piece

    own = {"piece", "origin_us", "start_px", "begun", "cut_s", "calibration", "force"}
    given = {name: value for name, value in settings.items() if name not in own}
    calibration_path = Path(settings["calibration"])
    args = Args(recordings=(recording,), calibration=calibration_path, **given)
    tracking, calibration = configured(args, calibration_path)
    tracking = replace(tracking, hysteresis="none")
    source = open_events(recording, strict=args.strict, sensor=args.sensor)
    piece, origin_us = Piece.parse(settings["piece"]), int(settings["origin_us"])
    how = PieceTracking(tracking, calibration, origin_us)
    if "start_px" not in settings:
        return track_piece(source, piece, output, how)
    return mend_piece(
        source,
        piece,
        output,
        how,
        start_px=np.array(settings["start_px"], np.float64),
        begun=Path(settings["begun"]),
    )
