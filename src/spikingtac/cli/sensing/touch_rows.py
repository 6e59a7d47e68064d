"""Touches as rows of a table: in px, and in mm where the scale is known."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.atomic_files import replacing
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.touches.touch import Touch


def touch_row(touch: Touch, unit: str, px_per_mm: float | None) -> dict[str, Any]:
    """Return a touch as plain values: in px, and in mm where the scale is known.

    Args:
        touch: The touch.
        unit: Unit of its lengths, ``px`` or ``mm``.
        px_per_mm: The scale, 1 where the unit is mm, None where it is not known.
    """
    row: dict[str, Any] = {
        "begin_us": touch.begin_us,
        "end_us": touch.end_us,
        "duration_us": touch.duration_us,
        "peak_us": touch.peak_us,
        "peak_strength": round(touch.peak_strength, 6),
    }
    if unit == "px":
        row |= _lengths(touch, "px", 1.0)
    if px_per_mm is not None:
        row |= _lengths(touch, "mm", px_per_mm)
    return row


def _lengths(touch: Touch, unit: str, scale: float) -> dict[str, Any]:
    return {
        f"place_{unit}": (touch.place_px / scale).round(4).tolist(),
        f"area_{unit}2": round(touch.area_px2 / scale**2, 4),
        f"peak_displacement_{unit}": round(touch.peak_displacement_px / scale, 5),
        f"outline_{unit}": (touch.outline_px / scale).round(3).tolist(),
    }


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write touches as CSV, one line each, whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    flat = [_flat(row) for row in rows]
    columns = list(flat[0]) if flat else ["begin_us", "end_us", "duration_us", "peak_us"]
    try:
        with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(flat)
    except OSError as error:
        raise ConfigError(f"cannot write {str(path)!r}: {error.strerror}") from error


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in row.items():
        if key.startswith("place_"):
            unit = key.removeprefix("place_")
            out[f"place_x_{unit}"], out[f"place_y_{unit}"] = value
        elif not key.startswith("outline_"):
            out[key] = value
    return out
