"""Places in a RAW decoder's state: clock, address, sensor, continuity and counters."""

from __future__ import annotations

HIGH, EPOCH, BASE, NOW, ROW, VECTOR_X, VECTOR_P, WIDTH, HEIGHT = range(9)
REPEATS, CHANGES, UNCONFIRMED, EARLIER, EVENTS_BEFORE = range(9, 14)
FIRST_COUNTER = 14
BACKWARDS, RESET, JUMP, GAP, OUTSIDE, MISSING, UNKNOWN, TRIGGERS, PADDINGS, VENDOR, GLITCH = range(
    14, 25
)
FIELDS = 25

# Kinds of damage, in the order of their counters.
COUNTED = (
    "time_backwards", "time_reset", "time_jump", "gap", "out_of_range", "missing_state",
    "unknown_word", "trigger", "padding", "vendor_word", "time_glitch",
)  # fmt: skip

NONE = -1
NO_ROW = 1 << 30  # A row that no sensor has: nothing can be placed yet.
