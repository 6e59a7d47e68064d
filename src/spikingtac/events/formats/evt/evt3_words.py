"""EVT 3.0 on the wire: types of words and widths of fields."""

from __future__ import annotations

ADDR_Y, ADDR_X, BASE_X, VECT_12, VECT_8 = 0x0, 0x2, 0x3, 0x4, 0x5
TIME_LOW, CONTINUED_4, TIME_HIGH, TRIGGER, OTHERS, CONTINUED_12 = 0x6, 0x7, 0x8, 0xA, 0xE, 0xF
PADDING = 0x9999
"""Filler that some USB bridges send to complete a buffer."""

TIME_LOW_BITS = TIME_HIGH_BITS = 12
UNKNOWN_TYPES = (1 << 0x1) | (1 << 0x9) | (1 << 0xB) | (1 << 0xC) | (1 << 0xD)
"""Types that the format does not define, as a bit set."""
