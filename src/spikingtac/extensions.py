"""What other installed packages add to this one, through entry points.

A package declares it in its own ``pyproject.toml``::

    [project.entry-points."spikingtac.contact_detectors"]
    my_detector = "my_package.detector:build"
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from spikingtac.errors import ConfigError


def installed(group: str) -> dict[str, Callable[..., Any]]:
    """Return the functions that other packages offer under a group of entry points.

    A function is imported when it is first called, so listing the names imports nothing.

    Args:
        group: Name of the group, such as ``spikingtac.contact_detectors``.
    """
    return {entry.name: _loading(entry) for entry in entry_points(group=group)}


def _loading(entry: EntryPoint) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        try:
            function = entry.load()
        except (ImportError, AttributeError) as error:
            raise ConfigError(
                f"{entry.name!r} of the group {entry.group!r} cannot be loaded from "
                f"{entry.value!r}: {error}; reinstall or remove the package that declares it"
            ) from error
        return function(*arguments, **named)

    return call
