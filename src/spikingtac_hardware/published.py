"""The paper's table of sensors, computed again from its own sizes and areas."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Kind = Literal["RGB", "event"]

PRINTED_DIGITS_MM = 1.0
"""The ratio is printed in whole millimetres (its unit, which the table leaves out)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PublishedSensor:
    """One row of the table, as printed.

    Attributes:
        name: Name of the sensor.
        kind: Frames or events.
        size_mm: Outer size, mm.
        area_factors_mm: Sides of the sensing area whose product is its area, mm.
        volume_mm3: Printed volume, mm³.
        area_mm2: Printed area, mm².
        ratio_mm: Printed volume over area ("D/A ratio").
        rate_hz: Printed rate; None where the table has none.
        cost_usd: Printed cost, dollars.
        cost_is: ``price`` of a product, ``estimate``, or ``material`` where nothing is marked.
    """

    name: str
    kind: Kind
    size_mm: tuple[float, float, float]
    area_factors_mm: tuple[float, float]
    volume_mm3: float
    area_mm2: float
    ratio_mm: float
    rate_hz: float | None
    cost_usd: float
    cost_is: Literal["price", "estimate", "material"]

    @property
    def computed_volume_mm3(self) -> float:
        """Product of the printed sides, mm³."""
        return math.prod(self.size_mm)

    @property
    def computed_area_mm2(self) -> float:
        """Product of the printed factors, mm²."""
        return math.prod(self.area_factors_mm)

    @property
    def computed_ratio_mm(self) -> float:
        """Volume over area, mm: how deep the sensor would be if it sensed on all of its front."""
        return self.computed_volume_mm3 / self.computed_area_mm2

    @property
    def slips(self) -> tuple[str, ...]:
        """Printed values that do not follow from the printed factors, beyond their rounding."""
        pairs = (
            ("volume", self.volume_mm3, self.computed_volume_mm3, 0.5),
            ("area", self.area_mm2, self.computed_area_mm2, 0.5),
            ("ratio", self.ratio_mm, self.computed_ratio_mm, 0.5 * PRINTED_DIGITS_MM),
        )
        return tuple(
            f"{name}: printed {printed:g}, computed {computed:.2f}"
            for name, printed, computed, rounding in pairs
            if abs(printed - computed) > rounding
        )


def _row(
    name: str,
    kind: Kind,
    size: tuple[float, float, float],
    area: tuple[float, float],
    printed: tuple[float, float, float, float | None, float],
    cost_is: Literal["price", "estimate", "material"],
) -> PublishedSensor:
    volume, whole_area, ratio, rate, cost = printed
    return PublishedSensor(
        name=name, kind=kind, size_mm=size, area_factors_mm=area, volume_mm3=volume,
        area_mm2=whole_area, ratio_mm=ratio, rate_hz=rate, cost_usd=cost, cost_is=cost_is,
    )  # fmt: skip


TABLE: tuple[PublishedSensor, ...] = (
    _row("GelSight-Mini", "RGB", (32, 28.5, 28), (19, 15), (25536, 285, 90, 25, 499), "price"),
    _row("GelStereo 2.0", "RGB", (30, 30, 29), (23, 23), (26100, 529, 49, 32, 114), "material"),
    _row("GelEvent", "event", (40, 40, 96), (32, 32), (153600, 1024, 150, 180, 2275), "estimate"),
    _row("Evetac", "event", (32, 33, 65), (19, 15), (68640, 285, 241, 1000, 5000), "estimate"),
    _row("NeuTac", "event", (200, 120, 100), (2 * math.pi * 10, 10),
         (2400000, 628, 3820, 300, 8000), "estimate"),
    _row("A. Khairi", "event", (116, 148, 88), (30, 40),
         (1510784, 1200, 1259, None, 5000), "estimate"),
    _row("SpikingTac", "event", (22, 22, 19), (20.6, 20.6),
         (9196, 424.36, 22, 350, 150), "material"),
)  # fmt: skip
"""Table I of the paper."""
