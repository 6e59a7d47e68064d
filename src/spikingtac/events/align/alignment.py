"""Recordings and a robot's poses on one clock: which map is used, and the files that follow it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.align.poses import Poses
from spikingtac.events.align.shared_motion import course_of, through_motion
from spikingtac.events.align.shared_triggers import SyncLine, through_triggers
from spikingtac.events.clock import US_PER_S, TimeMap
from spikingtac.events.evt.raw import RawParts, parts_of
from spikingtac.events.formats.file_source import FileSource, ReadOptions
from spikingtac.events.manifest import MANIFEST, name_of, read_manifest
from spikingtac.events.open import RECORDING_NAME, open_events
from spikingtac.events.recording import RecordingWriter
from spikingtac.events.retimed import RecordedClock, RetimedSource, clock_beside, is_same_folder

# How two clocks meet: at the host that recorded both, in what both sensors felt, or in a line
# whose edges both cameras timed; auto takes the host where the manifests know it, else the
# motion.
By = Literal["auto", "host", "motion", "triggers"]

# What the times of poses are: time of day, the host's monotonic clock, the sensor's own, or not
# known, to be found by motion; auto tells the first two by their size.
PoseClock = Literal["auto", "unix", "monotonic", "sensor", "motion"]

# Times from here on are times of day, s: monotonic clocks begin with their host.
UNIX_LEAST_S = 1e9

# Poses are on the host's monotonic clock where they come so close to the recording, s.
NEAR_S = 60.0


class SecondFinger:
    """The other finger's events on its own clock.

    Args:
        first: Recording whose clock is the time base.
        second: The other recording; the same folder again means its second sensor.
    """

    def __init__(self, first: Path, second: Path) -> None:
        if is_same_folder(first, second):
            path = first / name_of(RECORDING_NAME, 1)
            if not path.is_file():
                raise RecordingError(f"{str(first)!r} holds one sensor; name the other recording")
            self.source: FileSource = RawParts(parts_of(path), ReadOptions())
            self.clock = RecordedClock.of(read_manifest(first / name_of(MANIFEST, 1)))
        else:
            self.source, self.clock = open_events(second), clock_beside(second)


def map_between(
    first: Path, second: SecondFinger, by: By, channel: int | None = None
) -> tuple[TimeMap, float | None]:
    """Return the map from the second clock to the first, and how far the host's is from it.

    Args:
        first: Recording whose clock is the time base.
        second: The other finger.
        by: How the clocks meet.
        channel: Trigger input of the sync line; None for the only one that both hold.

    Returns:
        The map; and where it was not found by the host and the host knew one too, how much later
        the host's map puts the middle, us: what the cameras' transports differ by.

    Raises:
        ConfigError: The host was asked for, and the manifests know none in common.
        RecordingError: A recording cannot be read, or the two do not look alike.
    """
    base = clock_beside(first)
    by_host = None if base is None or second.clock is None else second.clock.on(base)
    if by == "host" and by_host is None:
        raise ConfigError(
            "these recordings know no host in common (record both with: spikingtac record); "
            "find their clocks by what both felt: --by motion"
        )
    if by_host is not None and by in ("auto", "host"):
        return by_host, None
    if by == "triggers":
        lines = SyncLine.of(second.source), SyncLine.of(open_events(first))
        found = through_triggers(*lines, channel)
    else:
        found = through_motion(course_of(second.source), course_of(open_events(first)))
    if by_host is None:
        return found, None
    middle_us = np.array([round(found.own_us)])
    return found, float((by_host(middle_us) - found(middle_us))[0])


def map_of_poses(poses: Poses, recording: Path, clock: PoseClock) -> tuple[TimeMap, PoseClock]:
    """Return the map from the poses' clock to the recording's, and which clock theirs is.

    Raises:
        ConfigError: The host's clock was asked for, and the recording does not know it.
        RecordingError: Poses and events do not look alike.
    """
    known = clock_beside(recording)
    chosen = _guessed(poses, known) if clock == "auto" else clock
    if chosen == "sensor":
        return TimeMap(learned_from="given"), chosen
    if chosen == "motion":
        return through_motion(poses.course(), course_of(open_events(recording))), chosen
    if known is None:
        raise ConfigError(
            f"{str(recording)!r} does not know its host's clock, as a recording of spikingtac "
            "record does; find the poses' by what moves: --poses-clock motion"
        )
    shift_s = known.unix_minus_monotonic_s if chosen == "unix" else 0.0
    found = known.mapping.inverse()
    return replace(found, own_us=found.own_us + shift_s * US_PER_S), chosen


def write_pair(
    folder: Path, first: FileSource, second: FileSource, time_map: TimeMap, fields: dict[str, Any]
) -> list[int]:
    """Write both sensors' events on the first one's clock into a folder.

    Args:
        folder: It exists.
        first: The first sensor's events.
        second: The other one's, on their own clock.
        time_map: From that clock to the first one's.
        fields: What the manifest says beside the map.

    Returns:
        Events of each.

    Raises:
        ConfigError: The sensors differ in size: one folder holds sensors of one size.
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
            for packet in source:
                writer.write(packet, number)
                counts[number] += len(packet)
            for kind, count in source.losses.kinds():
                writer.losses.add(kind, count)
        writer.describe(aligned=time_map.summary(), **fields)
    return counts


def _guessed(poses: Poses, known: RecordedClock | None) -> PoseClock:
    if known is None:
        return "motion"
    first_s, last_s = poses.t_us[0] / 1e6, poses.t_us[-1] / 1e6
    if first_s > UNIX_LEAST_S:
        return "unix"
    middle_s = known.mapping.base_us / US_PER_S
    reach_s = known.mapping.span_s / 2 + NEAR_S
    return "monotonic" if first_s - reach_s < middle_s < last_s + reach_s else "motion"
