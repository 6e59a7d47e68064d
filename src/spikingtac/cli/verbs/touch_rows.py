"""Touches as rows of a table: in px, and in mm where the scale is known."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spikingtac.atomic_files import replacing
from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.messages import Table
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.field import Estimate
    from spikingtac.touch.slip.held import HeldTouch
    from spikingtac.touch.slip.monitor import Slip
    from spikingtac.touch.touch import Touch
    from spikingtac.touch.vibration import Spectrum

UM_PER_MM = 1e3
IN_THE_IMAGE = SkinScale(1.0)  # Lengths stay what they are.


def touch_row(held: HeldTouch, unit: str, scale: SkinScale | None) -> dict[str, Any]:
    """Return a touch as plain values: in px, and in mm where the scale is known.

    Args:
        held: The touch, with its slips.
        unit: Unit of its lengths, ``px`` or ``mm``.
        scale: From the unit to mm, None where it is not known.
    """
    touch = held.touch
    row: dict[str, Any] = {
        "begin_us": touch.begin_us,
        "end_us": touch.end_us,
        "duration_us": touch.duration_us,
        "peak_us": touch.peak_us,
        "peak_strength": round(touch.peak_strength, 6),
    }
    if unit == "px":
        row |= _lengths(touch, "px", IN_THE_IMAGE)
    if scale is not None:
        row |= _lengths(touch, "mm", scale)
    row["slips"] = None if held.slips is None else [_slip(slip) for slip in held.slips]
    return row | {"field": _field(touch, unit, scale)}


def _field(touch: Touch, unit: str, scale: SkinScale | None) -> dict[str, float]:
    """Return the quantities of the field at the peak, each with its standard deviation."""
    field, scales = touch.field, {}
    if unit == "px":
        scales["px"] = 1.0
    if scale is not None:
        scales["mm"] = scale.mm_per_px(touch.place_px)
    told: dict[str, Estimate] = {}
    for name, factor in scales.items():
        told[f"mean_shear_x_{name}"] = field.mean_shear_x_px.times(factor)
        told[f"mean_shear_y_{name}"] = field.mean_shear_y_px.times(factor)
    told |= {name: getattr(field, name) for name in ("torsion_rad", "divergence", "curl", "strain")}
    values = {}
    for name, estimate in told.items():
        values[name], values[f"{name}_std"] = round(estimate.value, 6), round(estimate.sigma, 6)
    return values


def _slip_text(slips: list[dict[str, Any]] | None, first_us: int) -> str:
    """Return what slipped first, and when, ms from ``first_us``."""
    first = _first_slip(slips)
    if first["slips"] is None:
        return "unknown"
    for what, t_us in (("all", first["gross_us"]), ("part", first["incipient_us"])):
        if t_us is not None:
            return f"{what} from {(t_us - first_us) / 1e3:.0f}"
    return "none"


def _slip(slip: Slip) -> dict[str, Any]:
    return {
        "incipient_us": slip.incipient_us,
        "gross_us": slip.gross_us,
        "end_us": slip.end_us,
        "lead_us": slip.lead_us,
        "least_sticking_share": round(slip.least_sticking_share, 3),
    }


def _first_slip(slips: list[dict[str, Any]] | None) -> dict[str, Any]:
    """Return how many slips a touch had, and the first of each kind; nothing where none is told."""
    told = slips or []
    incipient = [slip["incipient_us"] for slip in told if slip["incipient_us"] is not None]
    gross = [slip["gross_us"] for slip in told if slip["gross_us"] is not None]
    return {
        "slips": None if slips is None else len(slips),
        "incipient_us": min(incipient, default=None),
        "gross_us": min(gross, default=None),
    }


def _lengths(touch: Touch, unit: str, scale: SkinScale) -> dict[str, Any]:
    local = scale.mm_per_px(touch.place_px)
    return {
        f"place_{unit}": scale.to_mm(touch.place_px).round(4).tolist(),
        f"area_{unit}2": round(touch.area_px2 * local**2, 4),
        f"peak_displacement_{unit}": round(touch.peak_displacement_px * local, 5),
        f"outline_{unit}": scale.to_mm(touch.outline_px).round(3).tolist(),
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
        elif key == "slips":
            out |= _first_slip(value)
        elif key != "field" and not key.startswith("outline_"):
            out[key] = value
    return out | row["field"]


def touch_table(
    name: str, rows: list[dict[str, Any]], px_per_mm: float | None, first_us: int
) -> Table:
    """Return the touches of a recording for a reader, times from ``first_us`` on."""
    unit = "mm" if px_per_mm is not None else "px"
    columns = (
        *("begin ms", "end ms", f"place {unit}", f"area {unit}2", f"displacement {unit}"),
        *("peak strain", "slip ms"),
    )
    shown = [
        (
            f"{(row['begin_us'] - first_us) / 1e3:.0f}",
            "-" if row["end_us"] is None else f"{(row['end_us'] - first_us) / 1e3:.0f}",
            "{:.1f}, {:.1f}".format(*row[f"place_{unit}"]),
            f"{row[f'area_{unit}2']:.1f}",
            f"{row[f'peak_displacement_{unit}']:.2f}",
            f"{row['peak_strength']:.3f}",
            _slip_text(row["slips"], first_us),
        )
        for row in rows
    ]
    return Table(f"touches in {name}, times from its first event", columns, shown, words=0)


def vibration_row(found: Spectrum, unit: str, skin: SkinScale | None) -> dict[str, Any]:
    """Return the line of a spectrum as plain values; in um, too, where the scale is known.

    Args:
        found: A spectrum with a line.
        unit: Unit of its amplitudes, ``px`` or ``mm``.
        skin: Scale of the skin in that unit, or None.
    """
    row: dict[str, Any] = {
        "t_us": found.t_us,
        "line_hz": round(found.line_hz or 0.0, 3),
        "noise_ratio": round(found.line_px / found.noise_px, 2),
    }
    values = {"amplitude": found.line_px, "sigma": found.noise_px}
    if unit == "px":
        row |= {f"{name}_px": round(value, 5) for name, value in values.items()}
    if skin is not None:
        scale = UM_PER_MM / skin.px_per_mm
        row |= {f"{name}_um": round(scale * value, 3) for name, value in values.items()}
    return row


def vibration_table(
    name: str, lines: list[dict[str, Any]], px_per_mm: float | None, first_us: int
) -> Table:
    """Return lines of vibration for a reader, times from ``first_us`` on."""
    unit = "px" if px_per_mm is None else "um"
    shown = [
        (
            f"{(row['t_us'] - first_us) / 1e3:.0f}",
            f"{row['line_hz']:.1f}",
            f"{row['noise_ratio']:.0f}",
            f"{row[f'amplitude_{unit}']:.3g} +- {row[f'sigma_{unit}']:.2g}",
        )
        for row in lines
    ]
    columns = ("until ms", "line Hz", "over noise", f"amplitude {unit}")
    return Table(f"vibration in {name}, the second before each time", columns, shown, words=0)
