"""Training pairs from recordings: two state maps of the same moments, from events alone.

The file ``truth.npz`` of a recording folder is never opened: :func:`load_clip` reads the events
through :func:`spikingtac.events.open.open_events`, and nothing else. Each round degrades each
recording anew, so that no pair occurs twice.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from spikingtac.denoise import Median3
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events import BackgroundActivityFilter, open_events
from spikingtac.state_map import BinaryStateMap, GradedStateMap, StateMap
from spikingtac.types import US_PER_S, EventPacket

LEVELS = 255  # Largest value of a stored map, one byte per pixel; a step of a graded map is 35.


# Window of the activity filter before the target map, us. The recording's own noise adds only
# variance to the gradient: behind the filter the network learns in minutes what it does not learn
# in an hour without it.
TARGET_FILTER_US = 20_000

# Ranges of the input's degradation (assumed; wider than what the sensor's presets have): added
# background, Hz per pixel, drawn log-uniformly; fraction of events that are lost, drawn uniformly.
NOISE_HZ, DROP = (0.02, 5.0), (0.0, 0.6)

# Range of the product of background rate and window of the input's activity filter, drawn
# log-uniformly, and shortest and longest window, us. About an eighth of the product is the fraction
# of noise events that pass.
FILTER_NOISE_PRODUCT, FILTER_US = (0.005, 0.06), (3_000, 80_000)

# Fraction of the inputs without that filter, and their largest background, Hz per pixel. With more,
# a binary map is half white after some seconds and teaches nothing.
UNFILTERED_FRACTION, UNFILTERED_NOISE_HZ = 0.25, 0.3
GRADED_FRACTION = 0.3  # Fraction of the pairs from graded maps; the others are binary.


@dataclass(frozen=True, slots=True)
class Clip:
    """Events of a recording in memory, and its initial map.

    Attributes:
        name: Name for the log.
        events: All events.
        start: ``(height, width)`` initial map, float32 from 0 to 1.
    """

    name: str
    events: EventPacket
    start: NDArray[np.float32]


class Pairs(NamedTuple):
    """Inputs and targets of one round: ``(n, height, width)`` uint8 each, 255 for level 1."""

    inputs: NDArray[np.uint8]
    targets: NDArray[np.uint8]


def load_clip(path: str | Path, start: NDArray[np.float32] | None = None) -> Clip:
    """Read the events of a recording, and nothing else.

    Args:
        path: Recording folder or event file.
        start: ``(height, width)`` initial map, for example of :func:`map_after`; None is the zero
            matrix of the paper.

    Raises:
        RecordingError: The recording cannot be read, or has no events.
        ConfigError: The initial map has another size.
    """
    source = open_events(path)
    packets = [packet for packet in source if len(packet)]
    if not packets:
        raise RecordingError(f"{str(path)!r} holds no events to train on")
    shape = (source.size[1], source.size[0])
    if start is not None and start.shape != shape:
        raise ConfigError(f"the start map has shape {start.shape}, {str(path)!r} asks for {shape}")
    events = EventPacket.concatenate(packets)
    return Clip(Path(path).name, events, np.zeros(shape, np.float32) if start is None else start)


def map_after(clip: Clip) -> NDArray[np.float32]:
    """Return the binary map at the end of a recording: bootstrap slides give the start of others.

    The activity filter comes first. Without it, ten seconds of leak and background leave the ground
    between the markers more white than black, and a network cannot learn from such a start.
    """
    state_map = BinaryStateMap(clip.events.size, clip.start)
    state_map.absorb(BackgroundActivityFilter(clip.events.size)(clip.events))
    return Median3().clean(state_map.values).copy()


def make_pairs(clips: Sequence[Clip], moments: int, random: Generator) -> Pairs:
    """Degrade each recording once and return one round of pairs.

    Args:
        clips: Recordings of one sensor size.
        moments: Number of moments of each recording.
        random: Source of the degradations and of the moments.
    """
    made = [_pairs_of(clip, moments, random) for clip in clips]
    return Pairs(*(np.concatenate(column) for column in zip(*made, strict=True)))


def _pairs_of(clip: Clip, moments: int, random: Generator) -> Pairs:
    graded = bool(random.random() < GRADED_FRACTION)
    events = clip.events
    span_us = events.t_end_us - events.t_start_us
    after_us = np.sort(random.integers(0, span_us, moments)) + events.t_start_us
    inputs = _maps(_degraded(events, random), clip.start, graded, after_us)
    target = BackgroundActivityFilter(events.size, TARGET_FILTER_US)(events)
    return Pairs(inputs, _maps(target, clip.start, graded, after_us))


def _degraded(events: EventPacket, random: Generator) -> EventPacket:
    rate_hz = float(np.exp(random.uniform(*np.log(NOISE_HZ))))
    drop = random.uniform(*DROP)
    wanted_us = US_PER_S * float(np.exp(random.uniform(*np.log(FILTER_NOISE_PRODUCT)))) / rate_hz
    window_us = round(min(max(wanted_us, FILTER_US[0]), FILTER_US[1]))
    unfiltered = random.random() < UNFILTERED_FRACTION
    if unfiltered:
        rate_hz = min(rate_hz, UNFILTERED_NOISE_HZ)
    noisy = with_background(with_drops(events, drop, random), rate_hz, random)
    return noisy if unfiltered else BackgroundActivityFilter(events.size, window_us)(noisy)


def _maps(
    events: EventPacket, start: NDArray[np.float32], graded: bool, at_us: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Return the maps ``(n, height, width)`` at some times, us."""
    state_map: StateMap = GradedStateMap(start) if graded else BinaryStateMap(events.size, start)
    out = np.empty((len(at_us), *start.shape), np.uint8)
    for index, levels in enumerate(maps_at(state_map, events, at_us)):
        out[index] = np.rint(LEVELS * levels)
    return out


def maps_at(
    state_map: StateMap, events: EventPacket, at_us: NDArray[np.int64]
) -> Iterator[NDArray[np.float32]]:
    """Yield the map at each of some times, us, in their order; the next one overwrites it."""
    for end_us in at_us.tolist():
        before, events = events.split(end_us)
        state_map.absorb(before)
        yield state_map.values


def with_background(packet: EventPacket, rate_hz: float, random: Generator) -> EventPacket:
    """Add background activity: Poisson in time, uniform over pixels, random polarity.

    Args:
        packet: Events of a stretch of time.
        rate_hz: Events per second and pixel; 0 returns the packet itself.
        random: Source of the noise.

    Returns:
        Events and noise in order of time. An event precedes noise of the same time.
    """
    width, height = packet.size
    span_us = packet.t_end_us - packet.t_start_us
    count = int(random.poisson(rate_hz * width * height * span_us / US_PER_S)) if rate_hz else 0
    if count == 0:
        return packet
    t = np.concatenate([packet.t, random.integers(packet.t_start_us, packet.t_end_us, count)])
    order = np.argsort(t, kind="stable")
    x = np.concatenate([packet.x, random.integers(0, width, count, np.uint16)])
    y = np.concatenate([packet.y, random.integers(0, height, count, np.uint16)])
    p = np.concatenate([packet.p, random.random(count) < 0.5])
    return EventPacket(
        x[order], y[order], p[order], t[order], packet.t_start_us, packet.t_end_us, packet.size
    )


def with_drops(packet: EventPacket, fraction: float, random: Generator) -> EventPacket:
    """Drop each event with probability ``fraction``, 0 to 1."""
    return packet.select(random.random(len(packet)) >= fraction) if fraction else packet
