"""Two recordings, or a recording and a robot's poses, on one clock.

Clocks meet through the host of both, or in a line whose edges both cameras timed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.clock import PPM, US_PER_S, TimeMap, through_moments
from spikingtac.events.evt.raw import RawSource, later_parts
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.formats.file_source import FileSource, ReadOptions
from spikingtac.events.formats.text import labelled_table
from spikingtac.events.open import is_same_folder, open_events
from spikingtac.events.recording import RecordedClock, RecordingWriter, RetimedSource, name_of
from spikingtac.types import FloatArray

# How two clocks meet: at the host of both, or in a line; auto takes the host where it is known.
By = Literal["auto", "host", "triggers"]

# Most that the two cameras' times of one edge differ, beside their clocks, us (inputs are
# sampled every microsecond, slow firmware stamps within 0.1 ms).
JITTER_US = 200.0
MOST_DRIFT_PPM = 200.0  # Most that two clocks drift apart (two crystals of 100 ppm), ppm.
EDGE_US = 1.0  # Resolution of trigger times, us: the least error of one edge.
CLEARLY = 0.5  # A second place that fits to this share of the best one makes that a guess.
LEAST_VOTES = 2  # Like intervals at one place from which on it is more than a chance.
LEAST_SHARED = 0.5  # Least share of one camera's edges that the other one has seen, too.
MOST_FITS = 4_000_000  # Pairs of intervals that are compared; of longer lines, some intervals.

# A line began while a camera recorded where its first edge comes after so many times its longest
# interval.
BEFORE_FIRST = 1.5

# What the times of poses are: time of day, the host's monotonic clock, or the sensor's own; auto
# tells the first two by their size.
PoseClock = Literal["auto", "unix", "monotonic", "sensor"]

UNIX_LEAST_S = 1e9  # From here on, times are times of day, s: hosts do not run so long.

# Name of a time column -> its unit, us.
TIME_COLUMNS = {"t_us": 1.0, "t_ns": 1e-3, "t_ms": 1e3, "t_s": US_PER_S, "timestamp": US_PER_S}

_Pairs = tuple[NDArray[np.intp], NDArray[np.intp]]


def second_finger(first: Path, second: Path) -> tuple[FileSource, RecordedClock | None]:
    """Open the other finger's events on its own clock, and that clock where it is known.

    The same folder again means its second sensor.
    """
    if not is_same_folder(first, second):
        return open_events(second), RecordedClock.beside(second)
    path = first / name_of("events.raw", 1)
    if not path.is_file():
        raise RecordingError(f"{str(first)!r} holds one sensor; name the other recording")
    return RawSource(path, ReadOptions(), later_parts(path)), RecordedClock.beside(first, 1)


def map_between(
    first: Path, second: FileSource, own: RecordedClock | None, by: By, channel: int | None
) -> tuple[TimeMap, float | None]:
    """Return the map from the second clock to the first.

    Where it was not found by the host and the host knows one too, the second value tells how much
    later the host's map puts the middle, us: what the cameras' transports differ by.

    Args:
        first: Recording whose clock is the time base.
        second: The other finger.
        own: Its clock, where the recording knows it.
        by: How the clocks meet.
        channel: Trigger input of the sync line; None for the only one that both hold.

    Raises:
        ConfigError: The host was asked for, and the manifests know none in common.
        RecordingError: A recording cannot be read, or the trigger edges do not agree.
    """
    by_host = None if own is None else own.on(RecordedClock.beside(first))
    if by == "host" and by_host is None:
        raise ConfigError(
            "these recordings know no host in common (record both with: spikingtac record); "
            "where both cameras timed the edges of one line, use --by triggers"
        )
    if by_host is not None and by != "triggers":
        return by_host, None
    found = through_triggers(SyncLine.of(second), SyncLine.of(open_events(first)), channel)
    if by_host is None:
        return found, None
    return found, by_host.at(found.own_us) - found.base_us


def write_pair(
    folder: Path, first: FileSource, second: FileSource, time_map: TimeMap, fields: dict[str, Any]
) -> list[int]:
    """Write both sensors' events and edges on the first one's clock; return the events' numbers.

    Args:
        folder: It exists.
        first: The first sensor's events.
        second: The other one's, on their own clock.
        time_map: From that clock to the first one's.
        fields: What the manifest says beside the map.
    """
    if first.size != second.size:
        raise ConfigError(
            f"the sensors are of {first.size[0]}x{first.size[1]} and "
            f"{second.size[0]}x{second.size[1]} px; one folder holds sensors of one size"
        )
    counts = [0, 0]
    placed = RetimedSource(second, time_map, ReadOptions())
    with RecordingWriter(folder, first.size, sensors=2) as writer:
        for number, source in enumerate((first, placed)):
            edges = 0
            for packet in source:
                edges = writer.pass_triggers(source.triggers, edges, number)
                writer.write(packet, number)
                counts[number] += len(packet)
            writer.pass_triggers(source.triggers, edges, number)
            for kind, count in source.losses.kinds():
                writer.losses.add(kind, count)
        writer.describe(aligned=time_map.summary(), **fields)
    return counts


class SyncLine(NamedTuple):
    """The trigger edges of a recording, and the time of its first event, us."""

    begun_us: int
    triggers: Triggers

    @classmethod
    def of(cls, source: FileSource) -> SyncLine:
        """Read a whole recording for its edges."""
        firsts = [int(packet.t[0]) for packet in source if len(packet)]
        return cls(firsts[0] if firsts else 0, source.triggers.select(slice(None)))


def through_triggers(own: SyncLine, base: SyncLine, channel: int | None = None) -> TimeMap:
    """Return the map from one clock to the other, from the edges that both cameras have seen.

    Args:
        own: The line as the mapped clock has timed it.
        base: The line as the base clock has.
        channel: The trigger input; None for the only one.

    Raises:
        ConfigError: The channel is not in both, or several are and none was chosen.
        RecordingError: The edges do not agree, or agree at several places.
    """
    mine, theirs = _edges(own.triggers, base.triggers, channel)
    pairs = _alike(mine, theirs)
    if pairs is None:
        single = len(mine) == len(theirs) == 1
        longest_us = max(np.diff(edges).max(initial=0) for edges in (mine, theirs))
        late_us = min(mine[0] - own.begun_us, theirs[0] - base.begun_us)
        if not single and late_us <= BEFORE_FIRST * longest_us:
            raise RecordingError(
                "the trigger edges agree at no place or at several, as a regular line's do; start "
                "the line after both recordings, or send edges at odd moments"
            )
        # The edges pair from the first one on, as long as their intervals are alike.
        both = min(len(mine), len(theirs))
        gaps, others = np.diff(mine[:both]), np.diff(theirs[:both])
        alike = np.append(np.abs(gaps - others) <= _reach_us(gaps), False)
        number = np.arange(int(alike.argmin()) + 1)
        pairs = number, number
    return _fitted(mine, theirs, pairs)


def _edges(own: Triggers, base: Triggers, channel: int | None) -> list[NDArray[np.int64]]:
    """Return both lines' times of rising edges, or of falling ones where one has no others."""
    both = sorted({*own.channel.tolist()} & {*base.channel.tolist()})
    if channel is None and len(both) != 1:
        told = f"of several channels ({', '.join(map(str, both))}); choose one: --trigger-channel"
        told = told if both else "of no channel; record them at once: record CAMERA --second CAMERA"
        raise ConfigError(f"both recordings hold triggers {told}")
    chosen = both[0] if channel is None else channel
    for rising in (True, False):
        seen = [line.t_us[(line.channel == chosen) & (line.edge == rising)] for line in (own, base)]
        if all(map(len, seen)):
            return [np.sort(times) for times in seen]
    raise ConfigError(
        f"the recordings have no kind of edge on channel {chosen} in common; channels with "
        f"triggers in both: {', '.join(map(str, both)) or 'none'}"
    )


def _alike(own: NDArray[np.int64], base: NDArray[np.int64]) -> _Pairs | None:
    """Return pairs of edges where intervals of like length lie at one place; None if nowhere."""
    gaps, others = np.diff(own), np.diff(base)
    some = np.arange(0, len(gaps), len(gaps) * len(others) // MOST_FITS + 1)
    alike = np.abs(np.subtract.outer(gaps[some], others)) <= _reach_us(gaps[some])[:, None]
    first, second = np.nonzero(alike)
    first = some[first]
    shifts = base[second] - own[first]
    ascending = np.sort(shifts)
    width = 2.0 * _reach_us(np.ptp(own))
    votes = np.searchsorted(ascending, ascending + width, side="right") - np.arange(len(shifts))
    if votes.max(initial=0) < LEAST_VOTES:
        return None
    start = ascending[votes.argmax()]
    rivals = votes[(ascending < start - width) | (ascending > start + 2.0 * width)]
    if rivals.max(initial=0) >= CLEARLY * votes.max():
        return None
    near = (shifts >= start) & (shifts <= start + width)
    first, second = first[near], second[near]
    return np.concatenate([first, first + 1]), np.concatenate([second, second + 1])


def _reach_us(span_us: Any) -> Any:
    """Return by how much the two clocks may time a span differently, us."""
    return JITTER_US + MOST_DRIFT_PPM * PPM * span_us


def _fitted(own: NDArray[np.int64], base: NDArray[np.int64], pairs: _Pairs) -> TimeMap:
    """Return the map through all edges that lie where the pairs put them."""
    placed = through_moments(own[pairs[0]], base[pairs[1]])(own)
    after = np.searchsorted(base, placed).clip(1, max(len(base) - 1, 1))
    around = base[np.stack([after - 1, after.clip(max=len(base) - 1)])]
    nearest = around[np.abs(around - placed).argmin(axis=0), np.arange(len(own))]
    hit = np.abs(nearest - placed) <= JITTER_US
    inside = (placed >= base[0] - JITTER_US) & (placed <= base[-1] + JITTER_US)
    if np.count_nonzero(hit) <= LEAST_SHARED * np.count_nonzero(inside):
        raise RecordingError(
            f"{np.count_nonzero(hit)} of {np.count_nonzero(inside)} trigger edges agree, more than "
            f"{LEAST_SHARED:.0%} are needed; is it one line, on the same channel?"
        )
    return through_moments(own[hit], nearest[hit], "triggers", EDGE_US)


class Poses(NamedTuple):
    """A robot's poses: ``(n,)`` times in order, us, ``(n, k)`` values, and the columns' names."""

    t_us: NDArray[np.int64]
    state: FloatArray
    names: tuple[str, ...]

    def save(self, path: Path, time_map: TimeMap) -> None:
        """Write ``.npz``, with the times on another clock; ``export --log`` takes it."""
        with replacing(path) as whole, whole.open("wb") as file:
            np.savez(file, **self._replace(t_us=time_map(self.t_us))._asdict())


def load_poses(path: Path, what: str = "poses") -> Poses:
    """Read a table with a header: one time column (``t_us``, ``t_s`` ...), and columns of numbers.

    Args:
        path: The table.
        what: What its columns hold, for the error.

    Raises:
        RecordingError: It cannot be read as that.
    """
    try:
        names, values = labelled_table(path)
        if len(times := [name for name in names if name in TIME_COLUMNS]) != 1:
            raise ValueError(f"its header has {len(times)} time columns")
        column = names.index(times[0])
        t_us = np.rint(values[:, column] * TIME_COLUMNS[names.pop(column)]).astype(np.int64)
        if (np.diff(t_us) < 0).any():
            raise ValueError("its times run backwards; sort the rows")
    except (OSError, ValueError) as error:
        raise RecordingError(
            f"{str(path)!r} is no table of {what}: {error}; it needs a header with one time column "
            f"({', '.join(TIME_COLUMNS)}) and columns of numbers, such as x_mm,y_mm or fx,fy,fz"
        ) from error
    return Poses(t_us, np.delete(values, column, axis=1), tuple(names))


def map_of_poses(poses: Poses, recording: Path, clock: PoseClock) -> tuple[TimeMap, PoseClock]:
    """Return the map from the poses' clock to the recording's, and which clock theirs is.

    Raises:
        ConfigError: The host's clock is meant, and the recording does not know it.
    """
    unix = poses.t_us[0] / US_PER_S > UNIX_LEAST_S
    chosen: PoseClock = ("unix" if unix else "monotonic") if clock == "auto" else clock
    if chosen == "sensor":
        return TimeMap(learned_from="given"), chosen
    known = RecordedClock.beside(recording)
    if known is None:
        raise ConfigError(
            f"{str(recording)!r} does not know its host's clock, as a recording of spikingtac "
            "record does; where the poses are on the sensor's own, say --poses-clock sensor"
        )
    shift_s = known.unix_minus_monotonic_s if chosen == "unix" else 0.0
    found = known.mapping.inverse()
    return replace(found, own_us=found.own_us + shift_s * US_PER_S), chosen
