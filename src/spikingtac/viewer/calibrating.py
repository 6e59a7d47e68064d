"""Calibrating a sensor with the page: the guide, the result, and where it is saved."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import require_free
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import SpikingTacError
from spikingtac.events.create import create_events
from spikingtac.events.open import open_events
from spikingtac.events.source import EventSource
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.calibration.find_markers import CalibrationConfig
from spikingtac.stream.host import Asker, Host
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.guide import CalibrationGuide, GuideView

SHOWN_S = 0.25  # How often the guide's view is made anew: faster than it can be read, s.

# Events of a camera that a calibration from the page takes, the latest ones: 60 MB on disk.
# Contacts of ten seconds are a tenth of it.
MOST_EVENTS = 20_000_000
FULL = 255  # A share of 1 as a byte.


@dataclass(frozen=True, slots=True)
class NothingToTune:
    """The settings of a view that follows no marker: there are none."""


class GuideTracker:
    """Shows every event to a guide once, and tracks nothing.

    All copies are the tracker itself: what was seen stays seen when the viewer goes back in time,
    and a stretch that is played again tells nothing new.

    Args:
        size: ``(width, height)`` of the sensor, px.

    Attributes:
        guide: Sees the events.
        begin_us: Time of the first event that the guide has seen, us; None before.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.guide = CalibrationGuide(size)
        self.state_map = self  # the map that the page may show
        self.begin_us: int | None = None
        self._seen_us = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self

    @property
    def values(self) -> NDArray[np.float32]:
        """``(height, width)`` levels from 0 (ground) to 1 (marker)."""
        return self.guide.level

    def absorb(self, packet: EventPacket) -> None:
        """Show the guide what it has not seen."""
        if self.begin_us is None:
            self.begin_us = packet.t_start_us
        elif packet.t_start_us < self._seen_us:
            return
        self._seen_us = packet.t_end_us
        self.guide.absorb(packet)

    def estimate(self, t_us: int) -> MarkerFrame:
        """Return an estimate of no marker."""
        places = np.empty((0, 2))
        return MarkerFrame(t_us, places, places, places, np.empty(0, bool), np.empty(0))

    def reset(self) -> None:
        """Do nothing: what was seen stays seen."""


@dataclass(frozen=True, kw_only=True)
class SaveTarget:
    """Where a calibration goes.

    Attributes:
        path: The file.
        overwrite: Whether a file that is there may be replaced.
        anew: Calibrate even where a calibration is known.
    """

    path: Path = Path("calibration.json")
    overwrite: bool = False
    anew: bool = False


def _calibrate(asker: Asker, open_source: Callable[[], EventSource], result: Path) -> None:
    calibrate(open_source(), CalibrationConfig()).save(result)
    asker.tell(True)


class CalibrationDesk:
    """The calibration of one view, from the first event to the saved file.

    It runs in a process of its own, so that the page goes on meanwhile.

    Args:
        label: What the events are called.
        size: ``(width, height)`` of the sensor, px.
        target: Where the calibration goes.
        open_whole: Opens a recording from its beginning; None for a camera, of which the events
            that the guide has seen are taken.
        tracked_by: Returns how a view is tracked once there is a calibration.

    Attributes:
        tracker: The one that guides.
        tracked_by: As given.
    """

    def __init__(
        self,
        label: str,
        size: tuple[int, int],
        target: SaveTarget,
        open_whole: Callable[[], EventSource] | None,
        tracked_by: Callable[[Calibration], dict[str, Any]],
    ) -> None:
        self.tracker, self.tracked_by = GuideTracker(size), tracked_by
        self._label, self._target, self._open_whole = label, target, open_whole
        self._view, self._made_s = GuideView(size), 0.0
        self._host: Host | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None
        self._begun_s = 0.0
        self._tell("guide")

    def begin_anew(self) -> None:
        """Forget what the guide has seen, and a result that failed."""
        self.tracker.guide.reset()
        self.tracker.begin_us, self._made_s = None, 0.0
        if self._host is None:
            self._tell("guide")

    def calibrate(self, between: Callable[[int, int], EventPacket], t_us: int) -> None:
        """Begin to calibrate from the events up to a time; does nothing while that goes on.

        Args:
            between: Returns the events of a span, us; those of a camera are taken.
            t_us: Up to where they are taken, us.
        """
        if self._host is not None:
            return
        self._scratch = tempfile.TemporaryDirectory(prefix="spikingtac-calibration-")
        folder, opened = Path(self._scratch.name), self._open_whole
        if opened is None:  # a camera: its latest events go into a file
            events, stored = between(self.tracker.begin_us or 0, t_us), folder / "events.raw"
            if len(events) > MOST_EVENTS:
                events = between(int(events.t[-MOST_EVENTS]), t_us)
            with create_events(stored, events.size) as writer:
                writer.write(events)
            opened = partial(open_events, path=stored)
        work = partial(_calibrate, open_source=opened, result=folder / "result.json")
        self._host = Host("the calibration", work)
        self._begun_s = time.monotonic()
        self._tell("calibrating")

    def poll(self) -> Calibration | None:
        """Return the calibration once, when it is there; it is saved by then."""
        if self._host is None or self._scratch is None:
            return None
        try:
            if self._host.receive() is None:
                return None
            found = Calibration.load(Path(self._scratch.name) / "result.json")
        except Exception as error:  # told by the page
            self._tell("failed", str(error))
            self.close()
            return None
        self.close()
        found = replace(found, provenance={**found.provenance, "recording": self._label})
        notes, markers, path = found.provenance, len(found.radius_px), self._target.path
        figures = {
            "quality": notes["quality"],
            "grid": found.grid,
            "polarity": found.polarity,
            "markers": markers,
            "measured": markers - len(notes["missing"]),
            "missing": notes["missing"],
            "doubtful": notes["doubtful"],
            "explained": round(float(np.median(notes["explained"])), 3),
            "radius_px": round(float(found.radius_px.mean()), 2),
        }
        try:
            require_free(path, self._target.overwrite)
            found.save(path)
        except (SpikingTacError, OSError) as error:
            self._tell("done", f"It is used here, but was not saved: {error}", figures)
        else:
            self._tell("done", f"Saved as {path.resolve()}", figures)
        return found

    def shown(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Return what the page shows of all this: scalars, and arrays by marker."""
        if time.monotonic() - self._made_s >= SHOWN_S:
            self._made_s, self._view = time.monotonic(), self.tracker.guide.view()
        view, running_s = self._view, time.monotonic() - self._begun_s
        scalars = {
            **self._told,
            "running_s": round(running_s, 1) if self._host else None,
            "grid": view.grid,
            "markers": len(view.place_px),
            "radius_px": round(view.radius_px, 2),
            "enough": int(view.enough.sum()),
            "rests": view.rests,
            "ready": view.ready,
            "advice": view.advice(),
            "path": str(self._target.path.resolve()),
            "command": f"spikingtac calibrate {self._label} -o {self._target.path}",
        }
        if self._told["state"] == "done" or not len(view.place_px):
            return scalars, {}
        # Which way each marker should go: 0 is none, then left, right, up and down.
        return scalars, {
            "guide_px": view.place_px.astype(np.float32),
            "guide_share": np.round(view.share * FULL).astype(np.uint8),
            "guide_way": np.where(view.enough, 0, 1 + view.sides.argmin(axis=1)).astype(np.uint8),
        }

    def close(self) -> None:
        """End a run that goes on, and remove what it wrote."""
        if self._host is not None:
            self._host.close()
        if self._scratch is not None:
            self._scratch.cleanup()
        self._host = self._scratch = None

    def _tell(self, state: str, said: str = "", result: dict[str, Any] | None = None) -> None:
        self._told = {"state": state, "said": said, "result": result}
