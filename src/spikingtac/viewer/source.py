"""What is viewed: events with random access in time, how they are tracked, and the truth."""

from __future__ import annotations

import tempfile
import weakref
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.contact.detector import ContactDetector
from spikingtac.events.source import EventSource
from spikingtac.markers.registry import MarkerTracker
from spikingtac.touch.force.model import ForceModel, Wrench
from spikingtac.touch.slip.held import HeldTouchDetector
from spikingtac.touch.vibration import Spectrum, VibrationMonitor
from spikingtac.types import EventPacket, FloatArray, MarkerFrame

if TYPE_CHECKING:  # both need every kernel of the calibration and of touch
    from spikingtac.viewer.calibrating import CalibrationDesk

# How far the truth's last line is prolonged, us: one step of a simulation at 500 Hz.
BEYOND_US = 2_000

# Events that the files hold before they grow; they double, and stay sparse on disk.
FIRST_CAPACITY = 1 << 20

# Events of a camera that are stored, 3.5 GB: minutes at 1 Mev/s. Then the latest are kept, us.
MOST_EVENTS, KEPT_US = 1 << 28, 2_000_000
SPECTRUM_EVERY_US = 100_000  # How often the spectrum is made anew: faster than it can be read, us.
LARGEST_BINS = 250  # Bins of the spectrum that the page draws.

COLUMNS = {"x": np.uint16, "y": np.uint16, "p": np.bool_, "t": np.int64}


@dataclass(frozen=True, kw_only=True)
class ViewSource:
    """Everything that a session needs to show one sensor.

    Attributes:
        label: What the page is titled.
        source: The events.
        calibration: Where the markers rest.
        config: Settings of the tracker; those with metadata become controls.
        make_tracker: Builds a tracker from settings.
        make_detector: Builds the contact detector.
        truth: True positions, or None.
        rate_hz: Estimates per second.
        simulated: True where the events come from the digital twin.
        ends: True where the source ends by itself, so that its length is known at once.
        felt: Tells force, patch and vibration where a force model was given, or None.
        desk: Where a page calibrates a sensor that has no calibration yet, or None.
        calibrated_by: What the calibration is: a file's name, or where a scene brings it.
        own_calibration: True where the calibration is the sensor's by its making, as a scene's is;
            any other is compared with the events.
    """

    label: str
    source: EventSource
    calibration: Calibration
    config: Any
    make_tracker: Callable[[Any], MarkerTracker]
    make_detector: Callable[[], ContactDetector]
    truth: SampledTruth | None = None
    rate_hz: float = 1_000.0
    simulated: bool = False
    ends: bool = True
    felt: FeltLayer | None = None
    desk: CalibrationDesk | None = None
    calibrated_by: str = ""
    own_calibration: bool = False


class SampledTruth:
    """True positions sampled at given times, joined by straight lines.

    A simulation that goes on appends to it; just beyond the last sample the line is prolonged.

    Args:
        t_us: Increasing times, us.
        marker_px: ``(m, 2)`` positions at each of them, px.
    """

    def __init__(
        self, t_us: Iterable[int] = (), marker_px: Iterable[NDArray[np.floating]] = ()
    ) -> None:
        self._t_us, self._marker_px = list(t_us), list(marker_px)

    def append(self, t_us: NDArray[np.int64], marker_px: NDArray[np.floating]) -> None:
        """Add samples, later than those that are known."""
        self._t_us.extend(t_us.tolist())
        self._marker_px.extend(marker_px)

    def at(self, t_us: int) -> FloatArray | None:
        """Return ``(m, 2)`` positions at a time, or None where they are not known."""
        times_us = self._t_us
        if len(times_us) < 2 or not times_us[0] <= t_us <= times_us[-1] + BEYOND_US:
            return None
        after = min(max(bisect_right(times_us, t_us), 1), len(times_us) - 1)
        start_us, end_us = times_us[after - 1], times_us[after]
        first, last = (self._marker_px[row].astype(np.float64) for row in (after - 1, after))
        return first + (t_us - start_us) / (end_us - start_us) * (last - first)


class EventStore:
    """Stores every event of a source in temporary files, and returns any stretch of time.

    A source that goes on (a camera, a simulation) is pulled only as far as is asked for.

    Args:
        source: The events.
        most_events: Where more come, only the last :data:`KEPT_US` of them are kept, and what
            follows: a camera's may go on for days.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: What the source has lost so far, by kind.
        ended: True once the source has nothing more.
        t_start_us: First microsecond of the stream.
        kept_from_us: First microsecond whose events are still there.
        first_event_us: Time of the first event, or None while none has been pulled.
        t_end_us: First microsecond that was not pulled yet.
    """

    def __init__(self, source: EventSource, most_events: float = float("inf")) -> None:
        self._source, self.size, self.losses = source, source.size, source.losses
        self.ended, self.t_end_us, self._most = False, 0, most_events
        self.first_event_us: int | None = None
        self._stream: Iterator[EventPacket] = iter(source)
        self._columns: dict[str, NDArray[Any]] = {}
        self._events = 0
        # Files without a name: nothing is left of them, even where the process is killed.
        opened = ExitStack()
        self._files = {name: opened.enter_context(tempfile.TemporaryFile()) for name in COLUMNS}  # noqa: SIM115
        self._close_files = weakref.finalize(self, opened.close)
        self._grow(FIRST_CAPACITY)
        first = self._pull()
        self.t_start_us = self.kept_from_us = 0 if first is None else first.t_start_us

    def around(self, t_us: int) -> tuple[int | None, int | None]:
        """Return the times of the last event before ``t_us`` and of the next one from it on.

        None stands for an event that is not there, or was not pulled yet.
        """
        times_us = self._columns["t"][: self._events]
        place = int(np.searchsorted(times_us, t_us))
        last_us = int(times_us[place - 1]) if place else None
        return last_us, int(times_us[place]) if place < len(times_us) else None

    def extend_to(self, t_us: float) -> bool:
        """Pull the source until it covers ``t_us``; False where it ends before.

        Args:
            t_us: A time, us; infinity pulls everything of a source that ends.
        """
        while not self.ended and self.t_end_us < t_us:
            self._pull()
        return self.t_end_us >= t_us

    def between(self, t_start_us: int, t_end_us: int) -> EventPacket:
        """Return the events of ``[t_start_us, t_end_us)`` among those that were pulled (views)."""
        first, last = self._columns["t"][: self._events].searchsorted((t_start_us, t_end_us))
        x, y, p, t = (self._columns[name][first:last] for name in COLUMNS)
        return EventPacket(x, y, p, t, t_start_us, t_end_us, self.size)

    def close(self) -> None:
        """Remove the temporary files; packets that were returned stay valid.

        A source that runs by itself ends, as a camera and a scene do.
        """
        self._columns.clear()
        self._close_files()
        getattr(self._source, "close", lambda: None)()

    def _pull(self) -> EventPacket | None:
        packet = next(self._stream, None)
        if packet is None:
            self.ended = True
            return None
        if self._events + len(packet) > self._most:
            self._forget()
        if self.first_event_us is None and len(packet):
            self.first_event_us = int(packet.t[0])
        self.t_end_us = packet.t_end_us
        after = self._events + len(packet)
        if after > len(self._columns["t"]):
            self._grow(max(after, 2 * len(self._columns["t"])))
        for name, column in self._columns.items():
            column[self._events : after] = getattr(packet, name)
        self._events = after
        return packet

    def _forget(self) -> None:
        self.kept_from_us = max(self.kept_from_us, self.t_end_us - KEPT_US)
        first = int(np.searchsorted(self._columns["t"][: self._events], self.kept_from_us))
        for column in self._columns.values():
            column[: self._events - first] = column[first : self._events].copy()
        self._events -= first

    def _grow(self, capacity: int) -> None:
        for name, dtype in COLUMNS.items():
            file = self._files[name]
            # It makes the file longer. asarray: slices of np.memmap itself cost microseconds each.
            self._columns[name] = np.asarray(np.memmap(file, dtype, mode="r+", shape=(capacity,)))


class FeltLayer:
    """Takes every estimate and gives the page the latest quantities of touch."""

    def __init__(self, reference_px: FloatArray, rate_hz: float, force: ForceModel) -> None:
        """Begin at rest.

        Args:
            reference_px: ``(m, 2)`` markers at rest, px.
            rate_hz: Estimates per second.
            force: The force model of this sensor.

        Raises:
            ConfigError: The model is of another sensor.
        """
        force.require(reference_px, "px")
        self._reference, self._rate_hz, self._model = reference_px, rate_hz, force
        self._restart()

    def _restart(self) -> None:
        self._force = self._model.estimator()
        self._touches = HeldTouchDetector(self._reference)
        self._vibration = VibrationMonitor(self._rate_hz)
        self._last_us = self._spectrum_us = float("-inf")
        self._wrench: Wrench | None = None
        self._spectrum: Spectrum | None = None

    def take(self, frame: MarkerFrame) -> None:
        """Take the next estimate; an earlier one begins anew."""
        if frame.t_us <= self._last_us:
            self._restart()
        self._last_us = frame.t_us
        moved = frame.detected_px - self._reference
        self._wrench = self._force.update(frame.t_us, moved)
        self._touches.update(frame)
        self._vibration.update(frame.t_us, moved)
        if frame.t_us - self._spectrum_us >= SPECTRUM_EVERY_US:
            self._spectrum_us = frame.t_us
            self._spectrum = self._vibration.spectrum()

    def shown(self) -> dict[str, Any]:
        """Return what the page shows, as JSON can hold it."""
        if self._wrench is None:
            return {}
        patch, line, slip = self._touches.touches.patch, self._spectrum, self._touches.slip

        def rounded(values: FloatArray) -> Any:
            return np.round(values, 4).tolist()

        return {
            "force_n": rounded(self._wrench.force_n),
            "half_width_n": rounded(self._wrench.half_width[:3]),
            "place_px": None if patch is None else rounded(patch.place),
            "outline_px": None if patch is None else rounded(patch.outline),
            "slip": None if slip is None else slip.phase,
            "sticking_share": None if slip is None else round(slip.sticking_share, 3),
            "line_hz": None if line is None else line.line_hz,
            "line_px": 0.0 if line is None else line.line_px,
            "spectrum_hz": 0.0 if line is None else float(line.frequency_hz[1]),
            "spectrum_px": [] if line is None else rounded(line.amplitude_px[:LARGEST_BINS]),
        }
