"""The numbers that the paper prints, each with its place there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Published:
    """A printed number, measured on the authors' hardware.

    Attributes:
        value: The number as printed; fractions are 0 to 1.
        where: Table or section of the paper.
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
"""(method, metric) of the case ``all`` -> number that the paper prints."""

_HOLES = "table 'Quantitative results of position and radius deviation'"

HOLES: dict[tuple[str, str], Published] = {
    ("cross4-published", "position_rmse_kabsch_mm"): Published(0.0952, _HOLES),
    ("cross4-published", "radius_rmse_mm"): Published(0.0780, _HOLES + ", from its values"),
    ("cross4-published", "radius_mean_signed_mm"): Published(0.0452, _HOLES),
}
"""(method, metric) over all ten holes -> number that the paper prints. Its abstract calls the
signed mean an RMSE; the RMSE here follows from the ten printed errors."""

HOLE_ERRORS_MM: tuple[tuple[float, float], ...] = (
    (0.0924, 0.0159), (0.0756, -0.0214), (0.0625, 0.0663), (0.0729, 0.0330), (0.0965, 0.0242),
    (0.0539, 0.0513), (0.1068, -0.0280), (0.0671, 0.1350), (0.1195, -0.0046), (0.1572, 0.1799),
)  # fmt: skip
"""Position and radius error of holes 1 to 10 in that table, mm."""
