"""What a page is shown: a greeting with what is constant, frames with what changes, images."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.window import WINDOW_US
from spikingtac.events.quality import judge_events
from spikingtac.tuning import in_use
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.replay.playback import Playback
from spikingtac.viewer.source import ViewSource

WIDEST_PX = 640  # Larger sensors are shown at every second, third... pixel; a page is no wider.
AGE_BINS = 7  # Ages that are told apart; code 0 is no event, 1 to 7 ON, 9 to 15 OFF, oldest first.
OFF_CODE = 8

# Events drawn in one image; older ones of a burst would be painted over anyway.
MOST_EVENTS = 200_000

# Grey values of a pixel without event, and of one whose last event was ON or OFF.
GREY, ON_GREY, OFF_GREY = 128, 255, 0
LEVELS = 15  # Code of a white pixel in the state map's image.


def view_step(size: tuple[int, int]) -> int:
    """Return how many sensor pixels, along each axis, one displayed pixel stands for."""
    return -(-max(size) // WIDEST_PX)


def view_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return ``(width, height)`` of the displayed image, px."""
    step = view_step(size)
    return -(-size[0] // step), -(-size[1] // step)


def activity(packet: EventPacket) -> NDArray[np.uint8]:
    """Return the last event of each displayed pixel, as packed codes of polarity and age.

    Args:
        packet: The events of the exposure; its span defines the ages.

    Returns:
        ``((width * height + 1) // 2,)`` uint8 of the displayed image, row by row; the first pixel
        of each pair sits in the high half.
    """
    packet = packet.sound()
    step, (width, height) = view_step(packet.size), view_size(packet.size)
    recent = slice(max(len(packet) - MOST_EVENTS, 0), None)
    span_us = max(packet.t_end_us - packet.t_start_us, 1)
    age = 1 + (packet.t[recent] - packet.t_start_us) * AGE_BINS // span_us
    code = np.where(packet.p[recent], age, age + OFF_CODE).astype(np.uint8)
    image = np.zeros((height, width), np.uint8)
    # Events are in order of time, and NumPy assigns in order: the last event of a pixel stays.
    image[packet.y[recent] // step, packet.x[recent] // step] = code
    return pack(image)


def grey_image(packet: EventPacket) -> NDArray[np.uint8]:
    """Return ``(height, width)`` grey values of the displayed image: OFF dark, ON bright."""
    codes = unpack(activity(packet), view_size(packet.size))
    grey = np.where(codes == 0, GREY, np.where(codes < OFF_CODE, ON_GREY, OFF_GREY))
    return grey.astype(np.uint8)


def state_image(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return a state map as packed codes from 0 (ground) to 15 (marker).

    Args:
        values: ``(height, width)`` from 0 to 1.
    """
    step = view_step((values.shape[1], values.shape[0]))
    return pack((np.clip(values[::step, ::step], 0, 1) * LEVELS + 0.5).astype(np.uint8))


def pack(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return codes below 16 two to a byte, the first in the high half."""
    flat = codes.ravel()
    if len(flat) % 2:
        flat = np.append(flat, np.uint8(0))
    return np.bitwise_or(flat[0::2] << 4, flat[1::2], dtype=np.uint8)


def unpack(packed: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return ``(height, width)`` codes from :func:`pack`."""
    flat = np.stack([packed >> 4, packed & 15], axis=1).ravel()
    return flat[: size[0] * size[1]].reshape(size[1], size[0]).astype(np.uint8)


# Windows of the count series sent with each frame: about 1 s, so that a page may miss sixty.
COUNT_WINDOWS = 1_024
OVERVIEW_BINS = 600  # Bars of the timeline.
SHOWN_CONTACTS = 200  # Contacts listed for the timeline, the latest ones.
HALF_SECOND_US = 500_000  # Stretch over which the event rate is averaged.

# Stretch of a recording that is judged, us: its first 20 s, so that a long one opens at once.
JUDGED_US = 20_000_000

# A contact that makes no more events lasts while so many markers are displaced by so much, px.
# (Ours: a released skin's creep is below it, and one lost marker is no touch.)
TOUCHED_PX, TOUCHED_MARKERS = 1.0, 3
FULL = 255  # Confidence 1 as a byte.


def starting(view: ViewSource) -> dict[str, Any]:
    """Return the greeting while the session still gets ready."""
    return {
        "label": view.label,
        "simulated": view.simulated,
        "starting": "getting ready; the first start on a machine compiles for some seconds",
    }


def greeting(view: ViewSource, playback: Playback, config: Any) -> dict[str, Any]:
    """Return what a page needs before the first frame."""
    store, calibration = playback.store, view.calibration
    return {
        "label": view.label,
        "simulated": view.simulated,
        "size": list(store.size),
        "view_size": list(view_size(store.size)),
        "view_step": view_step(store.size),
        "grid": calibration.rows_and_columns,
        "reference_px": np.round(calibration.reference_px, 3).tolist(),
        "radius_px": np.round(calibration.radius_px, 3).tolist(),
        "px_per_mm": calibration.px_per_mm,
        "rate_hz": view.rate_hz,
        "truth": view.truth is not None,
        "ends": view.ends,
        "controls": [asdict(control) for control in in_use(config)],
        "window_us": WINDOW_US,
        "overview": _overview(playback),
        "opened": view.opened,
        "shelf": view.shelf.names() if view.shelf else None,
        "quality": None if len(calibration.reference_px) else _quality(playback),
    }


def moving(view: ViewSource, playback: Playback) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the scalars and arrays of the playback's present state, without images."""
    now_us, store = playback.position_us, playback.store
    p50_us, p99_us = playback.step_percentiles_us()
    last_window, counts = _counts(playback)
    contacts = sorted(t_us for t_us in playback.contacts if t_us <= now_us)[-SHOWN_CONTACTS:]
    latest = playback.contacts[contacts[-1]] if contacts else None
    scalars = {
        "t_us": now_us,
        "estimate_us": playback.frame.t_us if playback.frame else None,
        "aim_us": playback.aim_us,
        "t_start_us": store.t_start_us,
        "t_end_us": store.t_end_us,
        "steps": playback.steps,
        "step_p50_us": round(p50_us, 1),
        "step_p99_us": round(p99_us, 1),
        "events_per_s": round(events_per_s(playback)),
        "last_window": last_window,
        "contacts_us": contacts,
        "in_contact": playback.in_contact or (latest is not None and _displaced(playback.frame)),
        "contact": asdict(latest) if latest else None,
        "felt": view.felt.shown() if view.felt else None,
        "health": playback.frame.health.summary() if playback.frame else None,
    }
    guide, guided = view.desk.shown() if view.desk else (None, {})
    return {**scalars, "guide": guide}, {
        "counts": counts,
        **_markers(view, playback.frame),
        **guided,
    }


def events_per_s(playback: Playback) -> float:
    """Return the event rate of the half second before the position."""
    now_us, store = playback.position_us, playback.store
    recent_us = max(store.t_start_us, now_us - HALF_SECOND_US)
    return len(store.between(recent_us, now_us)) * 1e6 / max(now_us - recent_us, 1)


def images(
    playback: Playback, exposure_us: int, state_map: NDArray[np.floating] | None
) -> dict[str, NDArray[np.uint8]]:
    """Return the packed images: recent events, and the state map where one is given."""
    now_us = playback.position_us
    exposed = playback.store.between(now_us - exposure_us, now_us)
    layers = {"activity": activity(exposed)}
    return layers if state_map is None else {**layers, "map": state_image(state_map)}


def _markers(view: ViewSource, frame: MarkerFrame | None) -> dict[str, NDArray[Any]]:
    if frame is None or not len(frame.position_px):
        return {}
    arrays: dict[str, NDArray[Any]] = {
        "detected_px": frame.detected_px.astype(np.float32),
        "position_px": frame.position_px.astype(np.float32),
        "held": frame.coasted.astype(np.uint8),
        "confidence": np.round(np.clip(frame.confidence, 0, 1) * FULL).astype(np.uint8),
    }
    truth = view.truth.at(frame.t_us) if view.truth else None
    return arrays if truth is None else {**arrays, "truth_px": truth.astype(np.float32)}


def _displaced(frame: MarkerFrame | None) -> bool:
    if frame is None:
        return False
    far_px = np.hypot(*frame.displacement_px.T)
    return int(np.count_nonzero(far_px >= TOUCHED_PX)) >= TOUCHED_MARKERS


def _counts(playback: Playback) -> tuple[int, NDArray[np.uint32]]:
    """Return the index of the last complete window, and the counts of those up to it."""
    store = playback.store
    last = (playback.position_us - store.t_start_us) // WINDOW_US - 1
    first = max(last - COUNT_WINDOWS + 1, 0)
    edges_us = store.t_start_us + np.arange(first, last + 2) * WINDOW_US
    return int(last), _histogram(playback, edges_us)


def _overview(playback: Playback) -> dict[str, Any]:
    store = playback.store
    edges_us = np.linspace(store.t_start_us, max(store.t_end_us, 1), OVERVIEW_BINS + 1)
    counts = _histogram(playback, edges_us.astype(np.int64))
    return {
        "t_start_us": store.t_start_us,
        "t_end_us": store.t_end_us,
        "counts": counts.tolist(),
    }


def _quality(playback: Playback) -> dict[str, Any]:
    """Return the figures of a recording's events, for the page."""
    store = playback.store
    end_us = min(store.t_end_us, store.t_start_us + JUDGED_US)
    found = judge_events(store.between(store.t_start_us, end_us))
    return {
        "rate_hz": round(found.rate_hz, 1),
        "on_fraction": None if found.on_fraction is None else round(found.on_fraction, 4),
        "noise_hz": round(found.noise_hz, 4),
        "hot_pixels": len(found.hot_px),
    }


def _histogram(playback: Playback, edges_us: NDArray[np.int64]) -> NDArray[np.uint32]:
    if len(edges_us) < 2:
        return np.empty(0, np.uint32)
    times_us = playback.store.between(int(edges_us[0]), int(edges_us[-1])).t
    return np.diff(np.searchsorted(times_us, edges_us)).astype(np.uint32)


def map_of(playback: Playback) -> NDArray[np.floating] | None:
    """Return the tracker's state map where it shows one."""
    shown = getattr(playback.tracker, "state_map", None)
    return getattr(shown, "values", None)
