"""``force.json``: a force model on disk, readable without this package."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.atomic_files import write_text
from spikingtac.errors import ConfigError
from spikingtac.schema import to_mapping
from spikingtac.touch.force.creep_memory import CreepConfig
from spikingtac.touch.force.laws import FAMILIES, ComponentLaw, ForceLaw
from spikingtac.touch.force.model import ForceModel, Interval
from spikingtac.touch.force.novelty import Novelty
from spikingtac.touch.force.rest_zero import RestZeroConfig
from spikingtac.touch.force.ridge import Ridge
from spikingtac.touch.force.shape import FieldBasis

FORCE_SCHEMA = 3
"""Version of the document."""
DIGITS = 7
"""Significant digits of a coefficient."""


def save_force(model: ForceModel, path: str | Path) -> None:
    """Write ``force.json``.

    Raises:
        ConfigError: The file cannot be written.
    """
    document = {
        "schema": FORCE_SCHEMA,
        "unit": model.unit,
        "components": list(model.components),
        "about": model.about,
        "zero": to_mapping(model.zero),
        "creep": to_mapping(model.creep),
        "rms": model.rms,
        "intervals": [to_mapping(interval) for interval in model.intervals],
        "novelty": {"deviation": _plain(model.novelty.deviation), "edge": model.novelty.edge},
        "laws": [_component(law) for law in model.laws],
        "reference": _plain(model.reference),
        "modes": _plain(model.basis.modes),
        "centers": _plain(model.basis.centers),
    }
    try:
        write_text(path, json.dumps(document, indent=1) + "\n")
    except OSError as error:
        raise ConfigError(f"cannot write {str(path)!r}: {error.strerror}") from error


def load_force(path: str | Path) -> ForceModel:
    """Read ``force.json``.

    Raises:
        ConfigError: The file is missing, is no JSON, or holds no force model.
    """
    hint = "make one with: spikingtac force fit FILES -o force.json"
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            f"cannot read the force model {str(path)!r}: {error.strerror}; {hint}"
        ) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{str(path)!r} is not JSON: {error}; {hint}") from error
    try:
        if document["schema"] != FORCE_SCHEMA:
            raise ValueError(f"schema {document['schema']}, this version reads {FORCE_SCHEMA}")
        return _model(document)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{str(path)!r} holds no force model: {error}; {hint}") from error


def _model(document: dict[str, Any]) -> ForceModel:
    dimensions = len(document["reference"][0])
    return ForceModel(
        unit=document["unit"],
        reference=_array(document["reference"]),
        rms=float(document["rms"]),
        basis=FieldBasis(_array(document["modes"]), _array(document["centers"]), dimensions),
        laws=tuple(_read_component(law) for law in document["laws"]),
        intervals=tuple(Interval(**interval) for interval in document["intervals"]),
        novelty=Novelty(
            _array(document["novelty"]["deviation"]), float(document["novelty"]["edge"])
        ),
        zero=RestZeroConfig(**document["zero"]),
        creep=CreepConfig(**{name: tuple(row) for name, row in document["creep"].items()}),
        about=dict(document["about"]),
    )


def _component(law: ComponentLaw) -> dict[str, Any]:
    return {
        "parts": [_law(part) for part in law.parts],
        "shares": list(law.shares),
        "correction": None if law.correction is None else _law(law.correction),
    }


def _read_component(values: dict[str, Any]) -> ComponentLaw:
    correction = values["correction"]
    return ComponentLaw(
        tuple(_read_law(part) for part in values["parts"]),
        tuple(float(share) for share in values["shares"]),
        None if correction is None else _read_law(correction),
    )


def _law(law: ForceLaw) -> dict[str, Any]:
    return {
        "family": law.family,
        "sign": law.sign,
        "floor_n": law.floor_n,
        "largest_n": law.largest_n if np.isfinite(law.largest_n) else None,
        "offset": law.ridge.offset,
        "center": _plain(law.ridge.center),
        "scale": _plain(law.ridge.scale),
        "weights": _plain(law.ridge.weights),
    }


def _read_law(values: dict[str, Any]) -> ForceLaw:
    if values["family"] not in FAMILIES:
        raise ValueError(f"unknown law {values['family']!r}")
    ridge = Ridge(
        _array(values["center"]),
        _array(values["scale"]),
        _array(values["weights"]),
        float(values["offset"]),
    )
    largest = values["largest_n"]
    return ForceLaw(
        values["family"],
        ridge,
        float(values["sign"]),
        float(values["floor_n"]),
        float("inf") if largest is None else float(largest),
    )


def _plain(values: NDArray[np.float64]) -> Any:
    rounded = [float(f"{value:.{DIGITS}g}") for value in values.ravel()]
    return np.array(rounded).reshape(values.shape).tolist()


def _array(values: Any) -> NDArray[np.float64]:
    out = np.asarray(values, np.float64)
    if not np.isfinite(out).all():
        raise ValueError("a coefficient is not a finite number")
    return out
