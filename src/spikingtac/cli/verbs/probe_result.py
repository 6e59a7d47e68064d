"""The result of ``spikingtac probe``, as summary, document and picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.atomic_files import require_free, write_json
from spikingtac.errors import ConfigError
from spikingtac.geometry.travel import TravelModel
from spikingtac.plots.hole import HolePicture, save_hole_plot
from spikingtac.plots.summary import PICTURE_ENDINGS
from spikingtac.robot.prober import Touched
from spikingtac.types import FloatArray

DOCUMENT, PICTURE = "hole.json", "hole.png"  # File names in an output folder.
COORDINATES = ("x_mm", "y_mm", "radius_mm")
DIGITS = 5  # Decimals of lengths in mm: a hundredth of a micrometre.


@dataclass(frozen=True, kw_only=True)
class ProbedHole:
    """The estimate of a hole, with the search that led to it.

    Attributes:
        picture: Estimate and readings, and the truth of the twin.
        touches: The contacts of the estimate, in the order of the circle's residuals.
        travel: The travel by which the readings were corrected.
        method: Names of search and detector.
        config: All settings, by stage.
        assumed: The assumptions, in sentences.
        arm: Address of the arm; None on the twin.
        grip: How the gripper holds the probe; None without a gripper.
    """

    picture: HolePicture
    touches: Sequence[Touched]
    travel: TravelModel
    method: Mapping[str, str]
    config: Mapping[str, Any]
    assumed: Sequence[str]
    arm: str | None = None
    grip: Mapping[str, Any] | None = None

    def summary(self) -> dict[str, Any]:
        """Return the summary that is printed: each coordinate with its sigma and its error."""
        out: dict[str, Any] = {"contacts": len(self.touches)}
        circle, error = self.picture.circle, self.picture.error_mm
        values = [*circle.center_mm, circle.radius_mm]
        for number, name in enumerate(COORDINATES):
            out[name] = round(float(values[number]), 4)
            out[f"{name}_sigma"] = round(float(circle.sigma_mm[number]), 4)
            if error is not None:
                out[f"{name}_error"] = round(float(error[number]), 4)
        if self.grip is not None:
            out["grip"] = dict(self.grip)
        return out | {"source": "robot" if self.arm else "twin", "simulated": self.arm is None}

    def document(self) -> dict[str, Any]:
        """Return the document that is written."""
        from spikingtac._version import package_version
        from spikingtac.schema import to_mapping

        circle, error, center_mm = self.picture.circle, self.picture.error_mm, None
        if self.picture.true_center_mm is not None:
            center_mm = _rounded(self.picture.true_center_mm)
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
            "truth": None
            if error is None
            else {
                "center_mm": center_mm,
                "radius_mm": self.picture.true_radius_mm,
                "error_mm": _rounded(error),
            },
            "config": to_mapping(self.config),
            "assumed": list(self.assumed),
        }

    @property
    def title(self) -> str:
        """Title of the picture in two lines: place and estimate."""
        circle = self.picture.circle
        (x, y), sigma = circle.center_mm, circle.sigma_mm
        place = "simulated" if self.arm is None else f"arm at {self.arm}"
        return (
            f"hole by touch ({place}): {self.method['search']}, {len(self.touches)} contacts\n"
            f"centre ({x:.3f} ± {sigma[0]:.3f}, {y:.3f} ± {sigma[1]:.3f}) mm, "
            f"radius {circle.radius_mm:.3f} ± {sigma[2]:.3f} mm (one sigma)"
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
    document, picture = paths
    write_json(document, found.document())
    save_hole_plot(picture, found.title, found.picture)
    return {"output": str(document), "picture": str(picture)}


def readings(touches: Sequence[Touched]) -> FloatArray:
    """Return the arm's positions ``(n, 2)`` at the decisions, mm."""
    return np.array([touch.reading_mm for touch in touches])


def _contact(touch: Touched, residual_mm: float) -> dict[str, Any]:
    vectors = ("start_mm", "direction", "reading_mm")
    told: dict[str, Any] = {name: _rounded(getattr(touch, name)) for name in vectors}
    return told | {"residual_mm": round(residual_mm, DIGITS)}


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), DIGITS) for value in values]
