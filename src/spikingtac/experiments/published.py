"""Numbers printed in the paper, each with the place where it stands."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Published:
    """One printed number, measured on the authors' hardware.

    Attributes:
        value: As printed; fractions are 0 to 1.
        where: Table or section.
    """

    value: float
    where: str


_TABLE = "table 'Performance Comparison of Point Tracking Algorithms'"

POINT_TRACKING: dict[tuple[str, str], Published] = {
    ("paper", "success_rate"): Published(1.0, _TABLE),
    ("paper", "return_mean_px"): Published(0.8039, _TABLE),
    ("paper", "return_std_px"): Published(0.4097, _TABLE),
    ("evetac", "success_rate"): Published(0.8, _TABLE),
    ("evetac", "return_mean_px"): Published(1.6276, _TABLE),
    ("evetac", "return_std_px"): Published(0.8525, _TABLE),
    ("neutac", "success_rate"): Published(1.0, _TABLE),
    ("neutac", "return_mean_px"): Published(1.4212, _TABLE),
    ("neutac", "return_std_px"): Published(0.5742, _TABLE),
}
"""(method, metric) of the case ``all`` -> what the paper prints."""

TRACKING_RATE_HZ = Published(350.0, "abstract")
"""Rate of the published tracker."""
