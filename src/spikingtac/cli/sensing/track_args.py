"""The options of ``spikingtac track``, and what they say about tracking."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from spikingtac.cli.many import ManyArgs
from spikingtac.types import LawName, Polarity

if TYPE_CHECKING:
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.markers.tracking_config import TrackingConfig
    from spikingtac.touch.force.model import ForceModel


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """Follow every marker through a recording and write its displacement over time.

    Many recordings (several paths, a folder, a quoted pattern) go into a folder, with a table of
    all results and a report: spikingtac track DAY --calibration C -o DAY_tracks --workers 4
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING...")
    ]
    """Event file, recording folder, or a camera: its address, a named pipe, or -. Several, a folder
    of recordings or a pattern such as 'day/*.raw' are tracked one by one."""
    calibration: Path
    """calibration.json of this sensor; make one with: spikingtac calibrate."""
    second: Annotated[Path | None, tyro.conf.arg(metavar="RECORDING")] = None
    """The other finger: its recording or camera, put on the first one's clock."""
    second_calibration: Path | None = None
    """calibration.json of the other finger."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """File to write: .npz, or .csv and .parquet in long form; tracks.npz unless given. A folder for
    many. The second finger's tracks.npz is tracks_1.npz."""
    preset: str = "default"
    """default (accurate), fast (10 kHz) or paper (as published), or a TOML file."""
    rate_hz: float | None = None
    """Estimates per second; the preset's unless given."""
    polarity: Polarity | None = None
    """White markers on dark ground, or dark on light; the calibration's unless given."""
    hysteresis: LawName | None = None
    """Law of the output position; the calibration's or the preset's unless given."""
    cut_s: float | None = None
    """One long recording: cut it every so many seconds, so that all --workers (or the --scheduler)
    track pieces of it; they overlap, and are joined. 60 is a good choice."""
    sensor: int = 0
    """In a folder, the sensor to read: 1 reads events_1.raw."""
    force: Path | None = None
    """force.json: estimate the wrench of every frame, too; make one with: spikingtac force fit."""
    strict: bool = False
    """Refuse a damaged recording instead of mending it, and the calibration of another sensor
    instead of a warning."""
    realtime: bool = False
    """For a camera: lock memory, stop garbage collection, and where the system permits it run
    before other work, on one core."""


def configured(args: Args, calibration_path: Path) -> tuple[TrackingConfig, Calibration]:
    """Return how markers are followed, and the sensor's calibration, as the options say."""
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.config import load_config

    calibration = Calibration.load(calibration_path)
    config = load_config(args.preset).with_tracking(
        rate_hz=args.rate_hz, hysteresis=args.hysteresis or calibration.hysteresis
    )
    return config.tracking, calibration.with_polarity(args.polarity)


def force_of(args: Args) -> ForceModel | None:
    """Return the force model that the options name, or None."""
    if args.force is None:
        return None
    from spikingtac.touch.force.files.model_file import load_force

    return load_force(args.force)
