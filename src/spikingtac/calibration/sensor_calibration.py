"""The calibration of one sensor: where its markers rest, and how they look."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_text
from spikingtac.calibration.document import (
    CALIBRATION_SCHEMA,
    MAPS,
    NUMBERS,
    checked_document,
    pack_map,
)
from spikingtac.calibration.lens import Lens, SkinScale, mean_pitch_px
from spikingtac.errors import PATH, CalibrationError, require_type
from spikingtac.file_kinds import told_kind
from spikingtac.types import FloatArray, one_line

# What errors of a file advise.
MAKE_ONE = "make one with: spikingtac calibrate RECORDING -o calibration.json"


@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """Where the markers rest, and what the recording taught about them.

    Attributes:
        reference_px: ``(m, 2)`` rest positions, row-major, px.
        radius_px: ``(m,)`` disc radii, px.
        grid: ``(rows, columns)``, or None where the markers do not fill rows.
        size: ``(width, height)`` of the sensor, px.
        polarity: ``"white"`` markers on dark ground, or ``"dark"`` on light.
        step_on: Share of the full swing that one ON event stands for, or None (use the preset's).
        step_off: The same for OFF events.
        step_on_map: ``(height, width)`` float32 shares per pixel, 0 where unknown; or None.
        step_off_map: The same for OFF events.
        contrast: Marker over ground intensity, ground over marker for dark ones; or None.
        edge_px: Logistic scale of a marker's edge, px, or None.
        marker_contrast: ``(m,)`` each marker's own contrast, or None (``contrast``).
        marker_edge_px: ``(m,)`` each marker's own edge scale, px, or None (``edge_px``).
        marker_step_on: ``(m,)`` each marker's own ``step_on``, or None.
        marker_step_off: ``(m,)`` each marker's own ``step_off``, or None.
        marker_measured: ``(m,) bool``, False where the recording could not tell: the marker's
            place is expected from the others. None counts as all True.
        lag_us: Delay of the events behind the motion, us, or None.
        dead_time_us: Time after an event for which a pixel is blind, us, or None (a usual one).
        px_per_mm: Image scale at the skin, or None where no pitch was given.
        lens: Where on the flat skin each pixel looks, or None: ``px_per_mm`` stands for all.
        recovery_s: Time in which pixels forget light that they lost without an event, s, or None:
            they do not (:mod:`spikingtac.markers.calibration.refine`).
        hot_px: ``(h, 2)`` columns and rows of pixels whose events tell nothing, or None
            (:mod:`spikingtac.events.hot_pixels`).
        hysteresis: Output law that this sensor's owner asked for, or None (the preset's).
        provenance: Where the calibration came from.
    """

    reference_px: FloatArray
    radius_px: FloatArray
    grid: tuple[int, int] | None
    size: tuple[int, int]
    polarity: str = "white"
    step_on: float | None = None
    step_off: float | None = None
    step_on_map: NDArray[np.float32] | None = None
    step_off_map: NDArray[np.float32] | None = None
    contrast: float | None = None
    edge_px: float | None = None
    marker_contrast: FloatArray | None = None
    marker_edge_px: FloatArray | None = None
    marker_step_on: FloatArray | None = None
    marker_step_off: FloatArray | None = None
    marker_measured: NDArray[np.bool_] | None = None
    lag_us: float | None = None
    dead_time_us: float | None = None
    px_per_mm: float | None = None
    lens: Lens | None = None
    recovery_s: float | None = None
    hot_px: NDArray[np.int64] | None = None
    hysteresis: str | None = None
    provenance: dict[str, Any] = field(default_factory=dict)

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Take lists for arrays, and refuse numbers that no file may hold (CalibrationError)."""
        if not len(self.reference_px):  # stands for a sensor that is not calibrated
            return
        document: dict[str, Any] = {"schema": CALIBRATION_SCHEMA, "polarity": self.polarity}
        document |= {name: getattr(self, name) for name in NUMBERS}
        found = checked_document(document, "this calibration is not possible", "")
        for name in NUMBERS:
            object.__setattr__(self, name, found.get(name))

    def with_pitch(self, pitch_mm: float) -> Calibration:
        """Return a copy with the scale in which neighbouring markers lie ``pitch_mm`` apart.

        Raises:
            ValueError: The pitch is not positive.
            ConfigError: There is one marker only.
        """
        if not pitch_mm > 0.0:
            raise ValueError(f"pitch_mm is {pitch_mm}, it must be positive, in millimetres")
        if (lens := self.lens) is not None:
            lens = lens.scaled(pitch_mm / mean_pitch_px(lens.to_mm(self.reference_px)))
        return replace(self, px_per_mm=mean_pitch_px(self.reference_px) / pitch_mm, lens=lens)

    def of_each_marker(self, name: str, default: float) -> FloatArray:
        """Return ``(m,)`` numbers: the markers' own where known, else the sensor's, else a default.

        Args:
            name: ``step_on``, ``step_off``, ``contrast`` or ``edge_px``.
            default: What stands where neither is known.
        """
        own, common = getattr(self, f"marker_{name}"), getattr(self, name) or default
        return np.full(len(self.reference_px), common) if own is None else own

    @property
    def skin_scale(self) -> SkinScale | None:
        """From pixels to the skin, or None where no pitch was given."""
        return None if self.px_per_mm is None else SkinScale(self.px_per_mm, self.lens)

    def scale(self) -> dict[str, Any]:
        """Return what tracks need of it: ``grid`` and, where known, ``px_per_mm`` and ``lens``."""
        known: dict[str, Any] = {} if self.px_per_mm is None else {"px_per_mm": self.px_per_mm}
        if self.lens is not None:
            known["lens"] = self.lens.document()
        return {"grid": self.grid, **known}

    def save(self, path: str | Path) -> None:
        """Write ``calibration.json``; optional values that are unknown are left out.

        Raises:
            CalibrationError: It holds what :meth:`load` refuses; nothing is written.
        """
        names = (*NUMBERS, *MAPS)
        known = {name: one for name in names if (one := getattr(self, name)) is not None}
        document = {
            "schema": CALIBRATION_SCHEMA,
            "grid": None,
            **{name: NUMBERS[name].written(known[name]) for name in NUMBERS if name in known},
            **{name: pack_map(known[name]) for name in MAPS if name in known},
            "polarity": self.polarity,
            **({} if self.hysteresis is None else {"hysteresis": self.hysteresis}),
            **({} if self.lens is None else {"lens": self.lens.document()}),
            "provenance": self.provenance,
        }
        checked_document(document, where=f"{str(path)!r} is not written")
        write_text(path, json.dumps(document, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read ``calibration.json``; a minimal file written by hand is accepted.

        Raises:
            CalibrationError: The file is missing, is no JSON, or a key is missing or unfit.
            ConfigError: No path was given.
        """
        require_type(path, PATH, "Calibration.load('calibration.json')")
        try:
            document = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise CalibrationError(
                f"cannot read the calibration {str(path)!r}: {error.strerror}; {MAKE_ONE}"
            ) from error
        except (ValueError, RecursionError) as error:
            told = told_kind(path) or f"it is not JSON ({error})"
            raise CalibrationError(
                f"{str(path)!r} is no calibration: {told}; {MAKE_ONE}"
            ) from error
        return cls.from_document(document, where=str(path))

    @classmethod
    def from_document(cls, document: Any, where: str = "calibration") -> Self:
        """Build a calibration from parsed JSON; see :meth:`load`."""
        fields = checked_document(document, where)
        lens = fields.pop("lens")
        return cls(**fields, lens=None if lens is None else Lens(**lens))
