"""What a page is shown: a greeting with what is constant, frames with what changes, images.

A frame is, little-endian: ``STV1``, uint32 length of the JSON, the JSON padded with spaces so that
the arrays begin at a multiple of 8 bytes, then the arrays, each padded likewise. The JSON's
``arrays`` lists ``[name, dtype, shape, offset from the first array]``, so that a reader needs no
other description.
"""

import json
import struct
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import WINDOW_US
from spikingtac.events.hot_pixels import judge_events
from spikingtac.tuning import in_use
from spikingtac.types import EventPacket, MarkerFrame
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.source import EventStore, ViewSource

# Largest frame: two packed images of 640x640, and the markers of any grid in use.
FRAME_BYTES = 2 << 20
GREETING_BYTES = 1 << 20  # Largest description of a view, which a page gets once.
MAGIC, PREFIX = b"STV1", struct.Struct("<4sI")
ALIGNED = 8  # The widest item that a typed array in a browser may start at, bytes.

WIDEST_PX = 640  # Larger sensors are shown at every second, third... pixel; a page is no wider.
AGE_BINS = 7  # Ages that are told apart; code 0 is no event, 1 to 7 ON, 9 to 15 OFF, oldest first.
OFF_CODE = 8

# Events drawn in one image; older ones of a burst would be painted over anyway.
MOST_EVENTS = 200_000
LEVELS = 15  # Code of a white pixel in the state map's image.

# Windows of the count series sent with each frame: about 1 s, so that a page may miss sixty.
COUNT_WINDOWS = 1_024
OVERVIEW_BINS = 600  # Bars of the timeline.
SHOWN_CONTACTS = 200  # Contacts listed for the timeline, the latest ones.
HALF_SECOND_US = 500_000  # Stretch over which the event rate is averaged, us.

# Stretch of a recording that is judged, us: its first 20 s, so that a long one opens at once.
JUDGED_US = 20_000_000

# A contact that makes no more events lasts while so many markers are displaced by so much, px.
# A released skin's creep is below it, and one lost marker is no touch.
TOUCHED_PX, TOUCHED_MARKERS = 1.0, 3
FULL = 255  # Confidence 1 as a byte.


def view_step(size: tuple[int, int]) -> int:
    """Return how many sensor pixels, along each axis, one displayed pixel stands for."""
    return -(-max(size) // WIDEST_PX)


def activity(packet: EventPacket) -> NDArray[np.uint8]:
    """Return the last event of each displayed pixel, as codes of polarity and age.

    Args:
        packet: The events of the exposure; its span defines the ages.

    Returns:
        ``(height, width)`` uint8 of the displayed image.
    """
    packet = packet.sound()
    step = view_step(packet.size)
    recent = slice(max(len(packet) - MOST_EVENTS, 0), None)
    span_us = max(packet.t_end_us - packet.t_start_us, 1)
    age = 1 + (packet.t[recent] - packet.t_start_us) * AGE_BINS // span_us
    image = np.zeros((-(-packet.size[1] // step), -(-packet.size[0] // step)), np.uint8)
    # Events are in order of time, and NumPy assigns in order: the last event of a pixel stays.
    code = np.where(packet.p[recent], age, age + OFF_CODE)
    image[packet.y[recent] // step, packet.x[recent] // step] = code
    return image


def pack(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return codes below 16, row by row, two to a byte, the first in the high half."""
    flat = np.append(codes, np.zeros(codes.size % 2, np.uint8))
    return np.bitwise_or(flat[0::2] << 4, flat[1::2], dtype=np.uint8)


def encode(meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return one message.

    Args:
        meta: Scalars and short lists that JSON can hold; the key ``arrays`` is taken.
        arrays: Little-endian arrays by name, of any shape.
    """
    listed, parts, offset = [], [], 0
    for name, array in arrays.items():
        body = np.ascontiguousarray(array).tobytes()
        listed.append([name, array.dtype.str.lstrip("<|"), list(array.shape), offset])
        parts.append(body + bytes(-len(body) % ALIGNED))
        offset += len(parts[-1])
    text = json.dumps({**meta, "arrays": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(text) + PREFIX.size) % ALIGNED)
    return b"".join((PREFIX.pack(MAGIC, len(text)), text, *parts))


def greeting(playback: Playback) -> dict[str, Any]:
    """Return what a page needs before the first frame."""
    view, store = playback.view, playback.store
    calibration, step = view.calibration, view_step(store.size)
    edges_us = np.linspace(store.t_start_us, max(store.t_end_us, 1), OVERVIEW_BINS + 1)
    quality = None
    # Events alone are judged, so that the page can tell what to mend before they are calibrated.
    if not len(calibration.reference_px):
        begin_us = store.kept_from_us
        found = judge_events(store.between(begin_us, min(store.t_end_us, begin_us + JUDGED_US)))
        quality = {
            "on_fraction": None if found.on_fraction is None else round(found.on_fraction, 4),
            "noise_hz": round(found.noise_hz, 4),
            "hot_pixels": len(found.hot_px),
        }
    return {
        "label": view.label,
        "simulated": view.simulated,
        "size": list(store.size),
        "view_size": [-(-side // step) for side in store.size],
        "view_step": step,
        "grid": calibration.grid,
        "reference_px": np.round(calibration.reference_px, 3).tolist(),
        "radius_px": np.round(calibration.radius_px, 3).tolist(),
        "px_per_mm": calibration.px_per_mm,
        "rate_hz": view.rate_hz,
        "truth": view.truth is not None,
        "ends": view.ends,
        "controls": [asdict(control) for control in in_use(playback.config)],
        "window_us": WINDOW_US,
        "overview": {
            "t_start_us": store.t_start_us,
            "t_end_us": store.t_end_us,
            "counts": _histogram(store, edges_us.astype(np.int64)).tolist(),
        },
        "quality": quality,
    }


def snapshot(
    playback: Playback, exposure_us: int, with_map: bool
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the scalars and the arrays of a frame.

    Args:
        playback: What is shown.
        exposure_us: Span of the events in the image, us.
        with_map: Show the tracker's state map, where it has one.
    """
    view, store, frame = playback.view, playback.store, playback.state.frame
    now_us, state = playback.position_us, playback.state
    contacts = sorted(t_us for t_us in playback.contacts if t_us <= now_us)[-SHOWN_CONTACTS:]
    latest = playback.contacts[contacts[-1]] if contacts else None
    displaced = 0 if frame is None else (np.hypot(*frame.displacement_px.T) >= TOUCHED_PX).sum()
    p50_us, p99_us = playback.step_percentiles_us()
    guide, guided = view.desk.shown() if view.desk else (None, {})
    last = (now_us - store.t_start_us) // WINDOW_US - 1  # the last complete window
    windows = np.arange(max(last - COUNT_WINDOWS + 1, 0), last + 2)
    scalars = {
        "t_us": now_us,
        "estimate_us": frame.t_us if frame else None,
        "t_start_us": store.t_start_us,
        "t_end_us": store.t_end_us,
        "last_window": int(last),
        "events_per_s": round(events_per_s(playback)),
        "step_p50_us": round(p50_us, 1),
        "step_p99_us": round(p99_us, 1),
        "contacts_us": contacts,
        "in_contact": getattr(state.detector, "in_contact", False)
        or bool(contacts and displaced >= TOUCHED_MARKERS),
        "contact": asdict(latest) if latest else None,
        "felt": view.felt.shown() if view.felt else None,
        "losses": dict(view.source.losses),
        "guide": guide,
    }
    counts = _histogram(store, store.t_start_us + windows * WINDOW_US)
    image = pack(activity(store.between(now_us - exposure_us, now_us)))
    arrays = {"counts": counts, **_markers(view, frame), **guided, "activity": image}
    levels = getattr(getattr(state.tracker, "state_map", None), "values", None)
    if with_map and levels is not None:  # from 0 (ground) to 1 (marker)
        step = view_step((levels.shape[1], levels.shape[0]))
        codes = np.clip(levels[::step, ::step], 0, 1) * LEVELS + 0.5
        arrays["map"] = pack(codes.astype(np.uint8))
    return scalars, arrays


def _markers(view: ViewSource, frame: MarkerFrame | None) -> dict[str, NDArray[Any]]:
    if frame is None or not len(frame.position_px):
        return {}
    truth_px = view.truth.at(frame.t_us) if view.truth else None
    arrays: dict[str, NDArray[Any]] = {
        "detected_px": frame.detected_px.astype(np.float32),
        "position_px": frame.position_px.astype(np.float32),
        "held": frame.coasted.astype(np.uint8),
        "confidence": np.round(np.clip(frame.confidence, 0, 1) * FULL).astype(np.uint8),
    }
    return arrays | ({} if truth_px is None else {"truth_px": truth_px.astype(np.float32)})


def events_per_s(playback: Playback) -> float:
    """Return the event rate of the half second before the position."""
    now_us, store = playback.position_us, playback.store
    recent_us = max(store.t_start_us, now_us - HALF_SECOND_US)
    return len(store.between(recent_us, now_us)) * 1e6 / max(now_us - recent_us, 1)


def _histogram(store: EventStore, edges_us: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Return the events from each edge to the next."""
    times_us = store.between(int(edges_us[0]), int(edges_us[-1])).t
    return np.diff(np.searchsorted(times_us, edges_us)).astype(np.uint32)
