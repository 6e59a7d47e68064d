"""Training pairs from recordings: two state maps of the same moments, from events alone.

The file ``truth.npz`` of a recording folder is never opened: :func:`load_clip` reads the events
through :func:`spikingtac.events.open.open_events`, and nothing else. Each round degrades each
recording anew, so that no pair occurs twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from spikingtac.denoise import Median3
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events import BackgroundActivityFilter, open_events
from spikingtac.state_map import BinaryStateMap, GradedStateMap, StateMap
from spikingtac.types import EventPacket

US_PER_S = 1e6
LEVELS = 255  # Largest value of a stored map, one byte per pixel; a step of a graded map is 35.


@dataclass(frozen=True, kw_only=True, slots=True)
class PairConfig:
    """How a recording becomes training pairs. All values are ours.

    Attributes:
        target_filter_us: Window of the activity filter before the target map, us; 0 is no filter.
            The recording's own noise adds only variance to the gradient: behind the filter the
            network learns in minutes what it does not learn in an hour without it.
        noise_hz: Range of the added background, Hz per pixel, drawn log-uniformly.
        drop: Range of the fraction of events that the input loses, drawn uniformly.
        filter_noise_product: Range of the product of background rate and window of the input's
            activity filter, drawn log-uniformly. About an eighth of it is the fraction of noise
            events that pass.
        filter_us: Shortest and longest window of that filter, us.
        unfiltered_fraction: Fraction of the inputs without a filter.
        unfiltered_noise_hz: Largest background of an unfiltered input, Hz per pixel. With more, a
            binary map is half white after some seconds and teaches nothing.
        graded_fraction: Fraction of the pairs from graded maps; the others are binary.
        moments: Number of moments of each recording in one round.
    """

    target_filter_us: int = 20_000
    noise_hz: tuple[float, float] = (0.02, 5.0)
    drop: tuple[float, float] = (0.0, 0.6)
    filter_noise_product: tuple[float, float] = field(
        default=(0.005, 0.06), metadata={"former_names": ("filter_share",)}
    )
    filter_us: tuple[int, int] = (3_000, 80_000)
    unfiltered_fraction: float = field(default=0.25, metadata={"former_names": ("unfiltered",)})
    unfiltered_noise_hz: float = 0.3
    graded_fraction: float = field(default=0.3, metadata={"former_names": ("graded",)})
    moments: int = 32

    def __post_init__(self) -> None:
        ranges = (self.noise_hz, self.filter_noise_product, self.filter_us)
        if any(not 0 < low <= high for low, high in ranges):
            raise ValueError(
                "noise_hz, filter_noise_product and filter_us must be ranges of positive "
                "numbers in increasing order"
            )
        if not 0 <= self.drop[0] <= self.drop[1] < 1:
            raise ValueError(f"drop is {list(self.drop)}, valid is 0 <= first <= second < 1")
        if not (0 <= self.unfiltered_fraction <= 1 and 0 <= self.graded_fraction <= 1):
            raise ValueError("unfiltered_fraction and graded_fraction must lie between 0 and 1")
        if self.moments < 1 or self.target_filter_us < 0:
            raise ValueError("moments must be at least 1, target_filter_us not negative")


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


@dataclass(frozen=True, slots=True)
class Pairs:
    """Inputs and targets of one round: ``(n, height, width)`` uint8 each, 255 for level 1."""

    inputs: NDArray[np.uint8]
    targets: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.inputs)


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


def make_pairs(clips: Sequence[Clip], config: PairConfig, random: Generator) -> Pairs:
    """Degrade each recording once and return one round of pairs.

    Args:
        clips: Recordings of one sensor size.
        config: Settings.
        random: Source of the degradations and of the moments.
    """
    made = [_pairs_of(clip, config, random) for clip in clips]
    return Pairs(
        np.concatenate([pairs.inputs for pairs in made]),
        np.concatenate([pairs.targets for pairs in made]),
    )


def _pairs_of(clip: Clip, config: PairConfig, random: Generator) -> Pairs:
    graded = bool(random.random() < config.graded_fraction)
    span_us = clip.events.t_end_us - clip.events.t_start_us
    after_us = np.sort(random.integers(0, span_us, config.moments)) + clip.events.t_start_us
    inputs = _maps(_degraded(clip.events, config, random), clip.start, graded, after_us)
    target = _filtered(clip.events, config.target_filter_us)
    return Pairs(inputs, _maps(target, clip.start, graded, after_us))


def _degraded(events: EventPacket, config: PairConfig, random: Generator) -> EventPacket:
    rate_hz = _log_uniform(config.noise_hz, random)
    drop = random.uniform(*config.drop)
    wanted_us = US_PER_S * _log_uniform(config.filter_noise_product, random) / rate_hz
    window_us = round(min(max(wanted_us, config.filter_us[0]), config.filter_us[1]))
    if random.random() < config.unfiltered_fraction:
        rate_hz, window_us = min(rate_hz, config.unfiltered_noise_hz), 0
    noisy = with_background(with_drops(events, drop, random), rate_hz, random)
    return _filtered(noisy, window_us)


def _filtered(events: EventPacket, window_us: int) -> EventPacket:
    if window_us == 0:
        return events
    return BackgroundActivityFilter(events.size, window_us)(events)


def _maps(
    events: EventPacket, start: NDArray[np.float32], graded: bool, at_us: NDArray[np.int64]
) -> NDArray[np.uint8]:
    state_map: StateMap = GradedStateMap(start) if graded else BinaryStateMap(events.size, start)
    out = np.empty((len(at_us), *start.shape), np.uint8)
    for index, part in enumerate(_parts(events, at_us)):
        state_map.absorb(part)
        out[index] = np.rint(LEVELS * state_map.values)
    return out


def _parts(events: EventPacket, until_us: NDArray[np.int64]) -> Iterator[EventPacket]:
    first, start_us = 0, events.t_start_us
    for end_us, last in zip(until_us, np.searchsorted(events.t, until_us), strict=True):
        yield events.part(first, int(last), start_us, int(end_us))
        first, start_us = int(last), int(end_us)


def _log_uniform(limits: tuple[float, float], random: Generator) -> float:
    return math.exp(random.uniform(math.log(limits[0]), math.log(limits[1])))


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
