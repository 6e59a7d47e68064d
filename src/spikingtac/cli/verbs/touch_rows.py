"""Touches as rows of a table: in px, and in mm where the scale is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import spikingtac as st
from spikingtac import touch
from spikingtac.batch.run import write_rows
from spikingtac.calibration.lens import SkinScale
from spikingtac.cli.messages import Table
from spikingtac.touch.field import Estimate

UM_PER_MM = 1e3
IN_THE_IMAGE = SkinScale(1.0)  # Lengths stay what they are.
TIMES = ("begin_us", "end_us", "duration_us", "peak_us")
SLIP = ("incipient_us", "gross_us", "end_us", "lead_us")  # Times of a slip, us.
Row = dict[str, Any]


def touch_row(held: st.HeldTouch, unit: str, scale: SkinScale | None) -> Row:
    """Return a touch as plain values: in px, and in mm where the scale is known.

    Args:
        held: The touch, with its slips.
        unit: Unit of its lengths, ``px`` or ``mm``.
        scale: From the unit to mm, None where it is not known.
    """
    found, field = held.touch, held.touch.field
    row: Row = {name: getattr(found, name) for name in TIMES}
    row["peak_strength"] = round(found.peak_strength, 6)
    scales = {"px": IN_THE_IMAGE} if unit == "px" else {}
    scales |= {} if scale is None else {"mm": scale}
    told: dict[str, Estimate] = {}
    for name, to_unit in scales.items():
        local = to_unit.mm_per_px(found.place_px) if name == "mm" else 1.0
        row |= {
            f"place_{name}": to_unit.to_mm(found.place_px).round(4).tolist(),
            f"area_{name}2": round(found.area_px2 * local**2, 4),
            f"peak_displacement_{name}": round(found.peak_displacement_px * local, 5),
            f"outline_{name}": to_unit.to_mm(found.outline_px).round(3).tolist(),
        }
        told[f"mean_shear_x_{name}"] = field.mean_shear_x_px.times(local)
        told[f"mean_shear_y_{name}"] = field.mean_shear_y_px.times(local)
    row["slips"] = None
    if held.slips is not None:
        row["slips"] = [
            {name: getattr(slip, name) for name in SLIP}
            | {"least_sticking_share": round(slip.least_sticking_share, 3)}
            for slip in held.slips
        ]
    told |= {name: getattr(field, name) for name in ("torsion_rad", "divergence", "curl", "strain")}
    row["field"] = {}
    for name, one in told.items():
        row["field"] |= {name: round(one.value, 6), f"{name}_std": round(one.sigma, 6)}
    return row


def write_touches(path: Path, rows: list[Row]) -> None:
    """Write touches as CSV, one line each, whole or not at all."""
    flat = [_flat(row) for row in rows]
    write_rows(path, list(flat[0]) if flat else TIMES, flat)


def _flat(row: Row) -> Row:
    out: Row = {}
    for key, value in row.items():
        if key.startswith("place_"):
            unit = key.removeprefix("place_")
            out[f"place_x_{unit}"], out[f"place_y_{unit}"] = value
        elif key == "slips":
            out |= {"slips": None if value is None else len(value)} | _first_slip(value)
        elif key != "field" and not key.startswith("outline_"):
            out[key] = value
    return out | row["field"]


def _first_slip(slips: list[Row] | None) -> Row:
    """Return the time of the first slip of each kind; None where there is none."""
    times = {name: [slip[name] for slip in slips or ()] for name in SLIP[:2]}
    return {name: min((t for t in of if t is not None), default=None) for name, of in times.items()}


def touch_table(name: str, rows: list[Row], first_us: int) -> Table:
    """Return the touches of a recording for a reader, times from ``first_us`` on."""
    unit = "mm" if rows and "place_mm" in rows[0] else "px"
    columns = ("begin ms", "end ms", f"place {unit}", f"area {unit}2", f"displacement {unit}",
               "peak strain", "slip ms")  # fmt: skip

    def since(t_us: int | None) -> str:
        return "-" if t_us is None else f"{(t_us - first_us) / 1e3:.0f}"

    shown = [
        (
            *(since(row[time]) for time in ("begin_us", "end_us")),
            "{:.1f}, {:.1f}".format(*row[f"place_{unit}"]),
            f"{row[f'area_{unit}2']:.1f}",
            f"{row[f'peak_displacement_{unit}']:.2f}",
            f"{row['peak_strength']:.3f}",
            _slip_text(row["slips"], first_us),
        )
        for row in rows
    ]
    return Table(f"touches in {name}, times from its first event", columns, shown, words=0)


def _slip_text(slips: list[Row] | None, first_us: int) -> str:
    """Return what slipped first, and when, ms from ``first_us``."""
    if slips is None:
        return "unknown"
    first = _first_slip(slips)
    for what, t_us in (("all", first["gross_us"]), ("part", first["incipient_us"])):
        if t_us is not None:
            return f"{what} from {(t_us - first_us) / 1e3:.0f}"
    return "none"


def vibration_row(found: touch.Spectrum, unit: str, skin: SkinScale | None) -> Row:
    """Return a line of vibration as plain values: in px, and in um where the scale is known.

    Args:
        found: The spectrum.
        unit: Unit of its lengths, ``px`` or ``mm``.
        skin: From the unit to mm, None where it is not known.
    """
    row: Row = {
        "t_us": found.t_us,
        "line_hz": round(found.line_hz or 0.0, 3),
        "noise_ratio": round(found.line_px / found.noise_px, 2),
    }
    scales = {"px": (1.0, 5)} if unit == "px" else {}
    scales |= {} if skin is None else {"um": (UM_PER_MM / skin.px_per_mm, 3)}
    for name, (scale, digits) in scales.items():
        row[f"amplitude_{name}"] = round(scale * found.line_px, digits)
        row[f"sigma_{name}"] = round(scale * found.noise_px, digits)
    return row


def vibration_table(name: str, lines: list[Row], first_us: int) -> Table:
    """Return lines of vibration for a reader, times from ``first_us`` on."""
    unit = "um" if lines and "amplitude_um" in lines[0] else "px"
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
