"""The result of ``spikingtac probe``, as summary, document and picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.atomic_files import require_free
from spikingtac.errors import ConfigError
from spikingtac.geometry.hole import Circle
from spikingtac.geometry.travel import TravelModel
from spikingtac.robot.prober import Touched
from spikingtac.types import FloatArray

DOCUMENT, PICTURE = "hole.json", "hole.png"
"""File names in an output folder."""
PICTURE_ENDINGS = (".png", ".svg", ".pdf")
COORDINATES = ("x_mm", "y_mm", "radius_mm")
DIGITS = 5
"""Decimals of lengths in mm: a hundredth of a micrometre."""


@dataclass(frozen=True, kw_only=True)
class TrueHole:
    """The true hole of the twin.

    Attributes:
        center_mm: ``(2,)`` centre, mm.
        radius_mm: Radius, mm.
    """

    center_mm: FloatArray
    radius_mm: float


@dataclass(frozen=True, kw_only=True)
class ProbedHole:
    """The estimate of a hole, with the search that led to it.

    Attributes:
        circle: Estimate and uncertainty.
        touches: The contacts of the estimate, in the order of the circle's residuals.
        travel: The travel by which the readings were corrected.
        method: Names of search and detector.
        config: All settings, by stage.
        assumed: The assumptions, in sentences.
        arm: Address of the arm; None on the twin.
        truth: The true hole; None on an arm.
        grip: How the gripper holds the probe; None without a gripper.
    """

    circle: Circle
    touches: Sequence[Touched]
    travel: TravelModel
    method: Mapping[str, str]
    config: Mapping[str, Any]
    assumed: Sequence[str]
    arm: str | None = None
    truth: TrueHole | None = None
    grip: Mapping[str, Any] | None = None

    @property
    def error_mm(self) -> FloatArray | None:
        """Errors ``(3,)`` of centre x, centre y and radius, mm; None without a truth."""
        if self.truth is None:
            return None
        away = self.circle.center_mm - self.truth.center_mm
        return np.append(away, self.circle.radius_mm - self.truth.radius_mm)

    def summary(self) -> dict[str, Any]:
        """Return the summary that is printed: each coordinate with its sigma and its error."""
        out: dict[str, Any] = {"contacts": len(self.touches)}
        values, error = [*self.circle.center_mm, self.circle.radius_mm], self.error_mm
        for number, name in enumerate(COORDINATES):
            out[name] = round(float(values[number]), 4)
            out[f"{name}_sigma"] = round(float(self.circle.sigma_mm[number]), 4)
            if error is not None:
                out[f"{name}_error"] = round(float(error[number]), 4)
        if self.grip is not None:
            out["grip"] = dict(self.grip)
        return out | {"source": "robot" if self.arm else "twin", "simulated": self.arm is None}

    def document(self) -> dict[str, Any]:
        """Return the document that is written."""
        from spikingtac._version import package_version
        from spikingtac.schema import to_mapping

        circle, error = self.circle, self.error_mm
        return {
            "package_version": package_version(),
            "simulated": self.arm is None,
            "arm": self.arm,
            "grip": None if self.grip is None else dict(self.grip),
            "method": dict(self.method),
            "center_mm": _rounded(circle.center_mm),
            "radius_mm": round(circle.radius_mm, DIGITS),
            "sigma_mm": _rounded(circle.sigma_mm),
            "covariance_mm2": circle.covariance_mm2.tolist(),
            "contacts": [
                _contact(touch, float(residual))
                for touch, residual in zip(self.touches, circle.residual_mm, strict=True)
            ],
            "travel": {
                "harmonics_mm": _rounded(self.travel.harmonics_mm),
                "sigma_mm": round(self.travel.sigma_mm, DIGITS),
                "across_flats_mm": self.travel.across_flats_mm,
                "heading_rad": self.travel.heading_rad,
            },
            "truth": self.truth
            and {
                "center_mm": _rounded(self.truth.center_mm),
                "radius_mm": self.truth.radius_mm,
                "error_mm": None if error is None else _rounded(error),
            },
            "config": to_mapping(self.config),
            "assumed": list(self.assumed),
        }

    @property
    def title(self) -> str:
        """Title of the picture in two lines: place and estimate."""
        x, y = self.circle.center_mm
        sigma = self.circle.sigma_mm
        place = "simulated" if self.arm is None else f"arm at {self.arm}"
        return (
            f"hole by touch ({place}): {self.method['search']}, {len(self.touches)} contacts\n"
            f"centre ({x:.3f} ± {sigma[0]:.3f}, {y:.3f} ± {sigma[1]:.3f}) mm, "
            f"radius {self.circle.radius_mm:.3f} ± {sigma[2]:.3f} mm (one sigma)"
        )


def output_paths(output: Path | None, overwrite: bool = False) -> tuple[Path, Path] | None:
    """Return the paths of document and picture, and create their folder.

    Args:
        output: A folder, a ``.json`` file, or a picture file; the other file is written beside it.
        overwrite: Whether files that are there may be replaced.

    Raises:
        ConfigError: The ending is not valid, the folder cannot be created, or a file is there.
    """
    if output is None:
        return None
    ending = output.suffix.lower()
    if ending == ".json":
        paths = output, output.with_suffix(".png")
    elif ending in PICTURE_ENDINGS:
        paths = output.with_suffix(".json"), output
    elif not ending or output.is_dir():
        paths = output / DOCUMENT, output / PICTURE
    else:
        raise ConfigError(
            f"--output is {str(output)!r}; give a folder, or a file that ends in .json, "
            f"{', '.join(PICTURE_ENDINGS)}"
        )
    try:
        paths[0].parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"cannot write into {str(paths[0].parent)!r}: {error.strerror}; give another folder"
        ) from error
    for path in paths:
        require_free(path, overwrite)
    return paths


def write(found: ProbedHole, paths: tuple[Path, Path]) -> dict[str, str]:
    """Write document and picture; return their paths for the summary."""
    from spikingtac.atomic_files import write_json
    from spikingtac.plots.hole import HolePicture, save_hole_plot

    document, picture = paths
    write_json(document, found.document())
    truth = found.truth
    drawing = HolePicture(
        circle=found.circle,
        reading_mm=np.array([touch.reading_mm for touch in found.touches]),
        true_center_mm=truth and truth.center_mm,
        true_radius_mm=truth and truth.radius_mm,
    )
    save_hole_plot(picture, found.title, drawing)
    return {"output": str(document), "picture": str(picture)}


def _contact(touch: Touched, residual_mm: float) -> dict[str, Any]:
    return {
        "start_mm": _rounded(touch.start_mm),
        "direction": _rounded(touch.direction),
        "reading_mm": _rounded(touch.reading_mm),
        "residual_mm": round(residual_mm, DIGITS),
    }


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
