"""Training pairs from recordings: two state maps of the same moments, from events alone.

A recording folder's ``truth.npz`` is never opened: :func:`load_clip` reads the events through
:func:`spikingtac.events.open.open_events`, and nothing else. Each round degrades each recording
anew, so that no pair is ever seen twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from spikingtac.denoise.classical import Median3
from spikingtac.denoise.training.degrade import US_PER_S, halves, with_background, with_drops
from spikingtac.errors import ConfigError, RecordingError
from spikingtac.events.filters import BackgroundActivityConfig, BackgroundActivityFilter
from spikingtac.events.open import open_events
from spikingtac.state_map.binary import BinaryStateMap
from spikingtac.state_map.graded import GradedStateMap
from spikingtac.state_map.state_map import StateMap
from spikingtac.types import EventPacket

LEVELS = 255
"""Levels of a stored map: one byte per pixel; a graded map's step is 35 of them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PairConfig:
    """How a recording becomes training pairs; all values are ours.

    Attributes:
        target: ``whole``: the degraded map shall predict the map of all events. ``halves``: the
            degraded map of one random half of the events shall predict the map of the other half.
        target_filter_us: Window of the activity filter before the target; 0 filters nothing. The
            recording's own noise adds nothing but variance to the gradient: behind the filter the
            network learns in minutes what it does not learn in an hour without.
        noise_hz: Range of the added background, per pixel and second, drawn log-uniformly.
        drop: Range of the share of events that the input loses, drawn uniformly.
        filter_share: Range of background times window of the input's activity filter, drawn
            log-uniformly: about an eighth of the share of noise events that pass.
        filter_us: Shortest and longest window of that filter.
        unfiltered: Share of the inputs that see no filter.
        unfiltered_noise_hz: Most background that an unfiltered input gets: beyond, a binary map is
            half white after some seconds and teaches nothing.
        graded: Share of the pairs from graded maps; the rest are binary.
        moments: Moments of each recording in one round.
    """

    target: Literal["whole", "halves"] = "whole"
    target_filter_us: int = 20_000
    noise_hz: tuple[float, float] = (0.02, 5.0)
    drop: tuple[float, float] = (0.0, 0.6)
    filter_share: tuple[float, float] = (0.005, 0.06)
    filter_us: tuple[int, int] = (3_000, 80_000)
    unfiltered: float = 0.25
    unfiltered_noise_hz: float = 0.3
    graded: float = 0.3
    moments: int = 32

    def __post_init__(self) -> None:
        ranges = (self.noise_hz, self.filter_share, self.filter_us)
        if any(not 0 < low <= high for low, high in ranges):
            raise ValueError(
                "noise_hz, filter_share and filter_us are ranges of positive numbers in order"
            )
        if not 0 <= self.drop[0] <= self.drop[1] < 1:
            raise ValueError(f"drop is {list(self.drop)}, valid is 0 <= first <= second < 1")
        if not (0 <= self.unfiltered <= 1 and 0 <= self.graded <= 1):
            raise ValueError("unfiltered and graded are shares between 0 and 1")
        if self.moments < 1 or self.target_filter_us < 0:
            raise ValueError("moments must be at least 1, target_filter_us not negative")


@dataclass(frozen=True, slots=True)
class Clip:
    """A recording's events in memory, and its map when it started.

    Attributes:
        name: For the log.
        events: All of them.
        start: ``(height, width)`` map that the recording begins with, float32 from 0 to 1.
        teacher: Events that the target map is made of, where they are others than the recording's:
            the simulator's noise-free ones, for the supervised upper bound and nothing else.
    """

    name: str
    events: EventPacket
    start: NDArray[np.float32]
    teacher: EventPacket | None = None


@dataclass(frozen=True, slots=True)
class Pairs:
    """Inputs and targets of one round: ``(n, height, width)`` uint8 each, 255 for level 1."""

    inputs: NDArray[np.uint8]
    targets: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.inputs)


def load_clip(path: str | Path, start: NDArray[np.float32] | None = None) -> Clip:
    """Read the events of a recording, and nothing but the events.

    Args:
        path: Recording folder or event file.
        start: Map at its beginning, as :func:`map_after` gives it for bootstrap slides; None is
            the null matrix with which the paper begins.

    Raises:
        RecordingError: It cannot be read, or holds no events.
        ConfigError: The start is of another size.
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
    """Return the binary map at a recording's end: bootstrap slides paint the start of others.

    The activity filter comes first: without it, ten seconds of leak and background leave the ground
    between the markers more white than black, and nothing can be learned from such a start.
    """
    state_map = BinaryStateMap(clip.events.size, clip.start)
    state_map.absorb(_filtered(clip.events, BackgroundActivityConfig().window_us))
    return Median3().clean(state_map.values).copy()


def make_pairs(clips: Sequence[Clip], config: PairConfig, random: Generator) -> Pairs:
    """Degrade each recording once and return one round of pairs.

    Args:
        clips: Recordings of one sensor size.
        config: How.
        random: Where the degradations and the moments come from.
    """
    made = [_pairs_of(clip, config, random) for clip in clips]
    return Pairs(
        np.concatenate([pairs.inputs for pairs in made]),
        np.concatenate([pairs.targets for pairs in made]),
    )


def _pairs_of(clip: Clip, config: PairConfig, random: Generator) -> Pairs:
    graded = bool(random.random() < config.graded)
    span_us = clip.events.t_end_us - clip.events.t_start_us
    after_us = np.sort(random.integers(0, span_us, config.moments)) + clip.events.t_start_us
    if config.target == "halves":
        first, second = halves(clip.events, random)
        made = []
        for one, other in ((first, second), (second, first)):
            inputs = _maps(_degraded(one, config, random), clip.start, graded, after_us)
            target = _filtered(other, config.target_filter_us)
            made.append((inputs, _maps(target, clip.start, graded, after_us)))
        return Pairs(*(np.concatenate(maps) for maps in zip(*made, strict=True)))
    inputs = _maps(_degraded(clip.events, config, random), clip.start, graded, after_us)
    target = (
        _filtered(clip.events, config.target_filter_us) if clip.teacher is None else clip.teacher
    )
    return Pairs(inputs, _maps(target, clip.start, graded, after_us))


def _degraded(events: EventPacket, config: PairConfig, random: Generator) -> EventPacket:
    rate_hz = _log_uniform(config.noise_hz, random)
    drop = random.uniform(*config.drop)
    wanted_us = US_PER_S * _log_uniform(config.filter_share, random) / rate_hz
    window_us = round(min(max(wanted_us, config.filter_us[0]), config.filter_us[1]))
    if random.random() < config.unfiltered:
        rate_hz, window_us = min(rate_hz, config.unfiltered_noise_hz), 0
    noisy = with_background(with_drops(events, drop, random), rate_hz, random)
    return _filtered(noisy, window_us)


def _filtered(events: EventPacket, window_us: int) -> EventPacket:
    if window_us == 0:
        return events
    return BackgroundActivityFilter(BackgroundActivityConfig(window_us=window_us), events.size)(
        events
    )


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
