"""Colours, names and numbers of the parts in pictures."""

from __future__ import annotations

from dataclasses import dataclass

from spikingtac_hardware.parameters.design import Design

Color = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Look:
    """How a part is shown.

    Attributes:
        label: Its name in a picture, with places for figures of the design.
        color: Red, green, blue, 0 to 1.
        opacity: 1, or less for what is clear.
        lift_mm: By which an exploded view shows it above its place, mm.
    """

    label: str
    color: Color
    opacity: float
    lift_mm: float


def _gray(level: float) -> Color:
    return level, level, level


LOOKS: dict[str, Look] = {
    "screws": Look("screws M{thread:g} × {length:g}", (0.72, 0.74, 0.77), 1.0, -13.0),
    "base": Look("base (printed)", (0.36, 0.40, 0.45), 1.0, 0.0),
    "connector": Look("connector", (0.85, 0.83, 0.76), 1.0, 7.0),
    "camera-board": Look("camera board", (0.16, 0.47, 0.33), 1.0, 7.0),
    "event-sensor": Look("event sensor", _gray(0.30), 1.0, 7.0),
    "lens-holder": Look("lens holder", _gray(0.26), 1.0, 12.0),
    "lens": Look("lens", (0.50, 0.53, 0.60), 1.0, 15.0),
    "led-board": Look("LED board", (0.90, 0.89, 0.84), 1.0, 19.0),
    "leds": Look("LEDs", (0.98, 0.84, 0.35), 1.0, 19.0),
    "shading-plate": Look("shading plate (printed)", _gray(0.30), 1.0, 24.0),
    "inserts": Look("heat-set inserts", (0.86, 0.66, 0.28), 1.0, 31.0),
    "shell": Look("shell (printed)", (0.36, 0.40, 0.45), 1.0, 38.0),
    "window": Look("window (acrylic)", (0.62, 0.80, 0.92), 0.55, 47.0),
    "gel": Look("clear gel", (0.75, 0.88, 0.95), 0.55, 54.0),
    "discs": Look("{paint} discs", _gray(0.97), 1.0, 61.0),
    "cover": Look("opaque cover", _gray(0.22), 1.0, 68.0),
}
"""Part of the sensor -> how it is shown."""


def look_label(name: str, design: Design) -> str:
    """Return the name of a part in a picture."""
    screws = design.fasteners
    return LOOKS[name].label.format(
        thread=screws.thread_mm, length=screws.length_mm, paint=design.skin.paint
    )
