"""Other views than of one tracked source: events alone, a folder's recordings, a second finger."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.batch.inputs import recordings_below
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.contact.event_count import SelfCalibratingDetector
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.address import is_address
from spikingtac.events.evt.raw_stream import is_stream
from spikingtac.events.manifest import name_of
from spikingtac.events.open import open_events, open_second
from spikingtac.events.retimed import is_same_folder
from spikingtac.events.source import EventSource
from spikingtac.sim.twin_camera import is_twin
from spikingtac.stream.host import Factory
from spikingtac.stream.sources import LiveSource
from spikingtac.viewer.calibrating import CalibrationDesk, SaveTarget
from spikingtac.viewer.opening import (
    CALIBRATION_NAME,
    NoCalibrationError,
    calibrated_view,
    open_felt_source,
    open_view_source,
)
from spikingtac.viewer.source import ViewSource


@dataclass(frozen=True, slots=True)
class NothingToTune:
    """The settings of a view without a tracker: there are none."""


def open_view_or_events(
    source: str, *, look: bool = False, save: SaveTarget | None = None, **options: Any
) -> ViewSource:
    """Open a view; where a recording or camera has no calibration, one of its events alone.

    Args:
        source: See :func:`~spikingtac.viewer.opening.open_view_source`.
        look: Show the events alone even where a calibration is known, to calibrate anew.
        save: Where a calibration that the page makes goes.
        **options: As there.

    Raises:
        SpikingTacError: As there, but for a missing calibration.
    """
    if not look:
        try:
            return open_view_source(source, **options)
        except NoCalibrationError:
            pass
    live, target = is_stream(Path(source)), save or SaveTarget()
    if is_twin(source) or not (live or Path(source).exists()):
        scene = open_view_source(source, **options)  # its events; the truth shows how well it went
        return _guided(
            scene, CalibrationDesk(scene.label, scene.source.size, target, None), options
        )
    events = LiveSource.in_process(source, None) if live else open_events(source)
    label = source if is_address(source) else Path(source).resolve().name
    whole: Factory[EventSource] | None = None
    if not live:
        whole = Factory(function=open_events, arguments={"path": source})
    desk = CalibrationDesk(label, events.size, target, whole)
    view = ViewSource(
        label=label,
        source=events,
        calibration=no_markers(events.size),
        config=NothingToTune(),
        make_tracker=desk.make_tracker,
        ends=not live,
        provenance={"input": label},
    )
    return _guided(view, desk, options)


def _guided(view: ViewSource, desk: CalibrationDesk, options: dict[str, Any]) -> ViewSource:
    """Return the view of the same events whose markers are not known yet."""
    preset, rate_hz = options.get("preset", "default"), options.get("rate_hz")
    contact = load_config(preset).contact
    return replace(
        view,
        calibration=no_markers(view.source.size),
        calibrated_by="",
        config=NothingToTune(),
        make_tracker=desk.make_tracker,
        make_detector=partial(SelfCalibratingDetector, contact.false_alarms_per_hour),
        desk=desk,
        calibrated=partial(calibrated_view, preset=preset, rate_hz=rate_hz),
    )


def no_markers(size: tuple[int, int]) -> Calibration:
    """Return a calibration of no marker for a sensor ``(width, height)``, px."""
    return Calibration(reference_px=np.empty((0, 2)), radius_px=np.empty(0), grid=(0, 0), size=size)


# A longer list cannot be overlooked; a command of a page holds 1,024 characters.
MOST_NAMES, LONGEST_NAME = 200, 500
LEVELS = 2  # Folders below the shelf's own that are looked into.


@dataclass(frozen=True, kw_only=True)
class Shelf:
    """The recordings of a folder, by their names relative to it.

    Attributes:
        folder: Nothing outside of it can be named, not by a link either.
        options: How each of them is opened, but for its ``source``.
    """

    folder: Path
    options: dict[str, Any] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Return the names of the recordings that are there now."""
        inside = self.folder.resolve()
        found: list[str] = []
        with suppress(OSError):  # a folder that may not be read ends the list
            for path in islice(recordings_below(self.folder, levels=LEVELS), MOST_NAMES):
                name = path.relative_to(self.folder).as_posix()
                if path.resolve().is_relative_to(inside) and len(name) <= LONGEST_NAME:
                    found.append(name)
        return found

    def open(self, name: str) -> ViewSource:
        """Open one of them.

        Raises:
            ConfigError: It is none of :meth:`names`.
            SpikingTacError: It cannot be opened.
        """
        if name not in self.names():
            raise ConfigError(
                f"{name[:LONGEST_NAME]!r} is no recording of {self.folder.name or 'this folder'!r};"
                " choose one of the list"
            )
        return self.opened(str(self.folder / name), name)

    def opened(self, source: str, name: str) -> ViewSource:
        """Return the view of a source that this shelf knows by a name."""
        opener: Callable[..., ViewSource] = (
            open_felt_source if "force" in self.options else open_view_or_events
        )
        return replace(opener(source=source, **self.options), shelf=self, opened=name)


def open_from_shelf(*, source: str, **options: Any) -> ViewSource:
    """Open a recording, and offer those of its folder.

    Args:
        source: An event file or a recording folder.
        **options: As of :func:`~spikingtac.viewer.openers.open_view_or_events`, or with
            ``force`` of :func:`~spikingtac.viewer.opening.open_felt_source`.

    Raises:
        SpikingTacError: As there.
    """
    path = Path(source)
    name = path.resolve().name  # of "." and "..", too
    folder = path.parent if path.name == name else path.resolve().parent
    return Shelf(folder=folder, options=options).opened(source, name)


def open_second_view(
    *, beside: str, source: str, calibration: str | None, **options: Any
) -> ViewSource:
    """Open the other finger's recording for viewing.

    Args:
        beside: The first finger's recording.
        source: The other one's; the same folder again means its second sensor.
        calibration: Path of its calibration; calibration_1.json of one folder unless given.
        **options: As of :func:`~spikingtac.viewer.opening.open_view_source`.

    Raises:
        SpikingTacError: As there.
    """
    path, same = Path(source), is_same_folder(Path(beside), Path(source))
    if same and not (path / name_of("events.raw", 1)).is_file():
        raise RecordingError(f"{source!r} holds one sensor; name the other finger's recording")
    if same and calibration is None:
        own = path / name_of(CALIBRATION_NAME, 1)
        if not own.is_file():
            raise NoCalibrationError(
                f"{source!r} holds no {own.name}; name the other finger's: --second-calibration"
            )
        calibration = str(own)
    opener = open_felt_source if "force" in options else open_view_source
    view = opener(source=source, calibration=calibration, **options)
    events, _ = open_second(Path(beside), path)
    if not same:
        return replace(view, source=events)
    # The truth in the folder is the first sensor's.
    return replace(view, source=events, truth=None, label=f"{view.label}, second finger")
