"""The solid modeller build123d, imported when it is first needed."""

from __future__ import annotations

import importlib
from typing import Any

from spikingtac.errors import MissingExtraError

Solid = Any
"""A solid of build123d; the library is optional, so that its types are not named."""


def modeller() -> Any:
    """Return the module build123d.

    Raises:
        MissingExtraError: The extra ``[design]`` is not installed.
    """
    return _optional("build123d")


def mesh_checker() -> Any:
    """Return the module trimesh.

    Raises:
        MissingExtraError: The extra ``[design]`` is not installed.
    """
    return _optional("trimesh")


def _optional(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"solids and drawings need {name}: pip install 'spikingtac[design]' "
            "(figures and checks need nothing more: leave -o away)"
        ) from error
