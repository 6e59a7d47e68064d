"""Lines of vibration as rows of a table: in px, and in um where the scale is known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from spikingtac.cli.messages import emit_table

if TYPE_CHECKING:
    from spikingtac.touch.vibration.event_vibration import VibrationLine

UM_PER_MM = 1e3


def vibration_rows(
    lines: list[VibrationLine] | None, px_per_mm: float | None
) -> list[dict[str, Any]] | None:
    """Return lines as plain values; None where nobody asked for them.

    Args:
        lines: The lines, in order of time.
        px_per_mm: Scale of the skin, or None.
    """
    return None if lines is None else [_row(line, px_per_mm) for line in lines]


def _row(line: VibrationLine, px_per_mm: float | None) -> dict[str, Any]:
    row = {
        "t_us": line.t_us,
        "line_hz": round(line.hz, 3),
        "noise_ratio": round(line.ratio, 2),
        "amplitude_px": _rounded(line.amplitude_px, 1.0),
        "sigma_px": _rounded(line.sigma_px, 1.0),
    }
    if px_per_mm is not None:
        row["amplitude_um"] = _rounded(line.amplitude_px, UM_PER_MM / px_per_mm)
        row["sigma_um"] = _rounded(line.sigma_px, UM_PER_MM / px_per_mm)
    return row


def _rounded(value: float | None, scale: float) -> float | None:
    return None if value is None else round(value * scale, 4)


def print_vibration(
    name: str, lines: list[VibrationLine], px_per_mm: float | None, first_us: int
) -> None:
    """Print the lines of a recording, times from ``first_us`` on."""
    unit = "px" if px_per_mm is None else "um"
    emit_table(
        f"vibration in {name}, the second before each time",
        ("until ms", "line Hz", "over noise", f"amplitude {unit}"),
        [
            (
                f"{(row['t_us'] - first_us) / 1e3:.0f}",
                f"{row['line_hz']:.1f}",
                f"{row['noise_ratio']:.0f}",
                _amplitude(row[f"amplitude_{unit}"], row[f"sigma_{unit}"]),
            )
            for row in vibration_rows(lines, px_per_mm) or []
        ],
        words=0,
    )


def _amplitude(value: float | None, sigma: float | None) -> str:
    return "too few events" if value is None else f"{value:.3g} +- {sigma:.2g}"
