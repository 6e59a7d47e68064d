"""Images for the page, four bits a pixel: recent events with their age, and the state map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.types import EventPacket

WIDEST_PX = 640
"""Larger sensors are shown at every second, third... pixel; a page is no wider."""
AGE_BINS = 7
"""Ages that are told apart; code 0 is no event, 1 to 7 ON, 9 to 15 OFF, oldest first."""
OFF_CODE = 8
MOST_EVENTS = 200_000
"""Events drawn in one image; older ones of a burst would be painted over anyway."""
GREY, ON_GREY, OFF_GREY = 128, 255, 0
"""Grey values of a pixel without event, and of one whose last event was ON or OFF."""
LEVELS = 15
"""Code of a white pixel in the state map's image."""


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
