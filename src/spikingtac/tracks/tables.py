"""Tracks as tables of pandas and as data sets of xarray."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import MissingExtraError
from spikingtac.tracks.columns import long_columns

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

UNITS = ("px", "mm")
"""Ends of names that are units."""

Arrays = Mapping[str, NDArray[Any]]
"""Values of tracks by their keys in a file; vectors are ``(n, m, 2)``."""


def as_pandas(arrays: Arrays) -> DataFrame:
    """Return tracks in long form; see :meth:`spikingtac.Tracks.to_pandas`.

    Raises:
        MissingExtraError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError(
            "tables need pandas; install it with: pip install 'spikingtac[tables]'"
        ) from error
    vectors = {name: values for name, values in arrays.items() if values.ndim == 3}
    return pandas.DataFrame(
        long_columns(arrays["t_us"], vectors, arrays["held"], arrays["confidence"])
    )


def as_xarray(arrays: Arrays, meta: Mapping[str, Any]) -> Dataset:
    """Return tracks with named axes; see :meth:`spikingtac.Tracks.to_xarray`.

    Raises:
        MissingExtraError: xarray is not installed.
    """
    try:
        import xarray
    except ImportError as error:
        raise MissingExtraError(
            "named axes need xarray; install it with: pip install 'spikingtac[xarray]'"
        ) from error
    places = {
        "t_us": arrays["t_us"],
        "marker": np.arange(len(arrays["reference_px"])),
        "axis": ["x", "y"],
    }
    variables = {
        name: (_axes(name, values), values, _unit(name))
        for name, values in arrays.items()
        if name not in places
    }
    told = {"meta": json.dumps(meta, sort_keys=True)}
    return xarray.Dataset(variables, {**places, **_grid(meta, len(places["marker"]))}, told)


def _axes(name: str, values: NDArray[Any]) -> tuple[str, ...]:
    if name == "reference_px":
        return ("marker", "axis")
    if name.startswith("wrench"):
        return ("t_us", "component")[: values.ndim]
    return ("t_us", "marker", "axis")[: values.ndim]


def _unit(name: str) -> dict[str, str]:
    unit = name.rpartition("_")[2]
    return {"units": unit} if unit in UNITS else {}


def _grid(meta: Mapping[str, Any], markers: int) -> dict[str, Any]:
    """Return the row and the column of each marker, or nothing where they are not known."""
    match meta.get("grid"):
        case [int(rows), int(columns)] if rows * columns == markers:
            row, column = np.divmod(np.arange(markers), columns)
            return {"row": ("marker", row), "column": ("marker", column)}
    return {}
