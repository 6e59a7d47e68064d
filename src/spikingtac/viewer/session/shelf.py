"""Other recordings that a page may open: those of one folder, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

from spikingtac.batch.inputs import recordings_below
from spikingtac.errors import ConfigError
from spikingtac.viewer.session.events_only import open_view_or_events
from spikingtac.viewer.session.opening import open_felt_source
from spikingtac.viewer.session.source import ViewSource

MOST_NAMES, LONGEST_NAME = 200, 500
"""A longer list cannot be overlooked; a command of a page holds 1,024 characters."""
LEVELS = 2
"""Folders below the shelf's own that are looked into."""


@dataclass(frozen=True, kw_only=True)
class Shelf:
    """The recordings of a folder, by their names relative to it.

    Attributes:
        folder: Nothing outside of it can be named, not by a link either.
        options: How each of them is opened, but for its ``source``.
    """

    folder: Path
    options: dict[str, Any] = field(default_factory=dict)

    def names(self) -> list[str]:
        """Return the names of the recordings that are there now."""
        inside = self.folder.resolve()
        found: list[str] = []
        with suppress(OSError):  # a folder that may not be read ends the list
            for path in islice(recordings_below(self.folder, levels=LEVELS), MOST_NAMES):
                name = path.relative_to(self.folder).as_posix()
                if path.resolve().is_relative_to(inside) and len(name) <= LONGEST_NAME:
                    found.append(name)
        return found

    def open(self, name: str) -> ViewSource:
        """Open one of them.

        Raises:
            ConfigError: It is none of :meth:`names`.
            SpikingTacError: It cannot be opened.
        """
        if name not in self.names():
            raise ConfigError(
                f"{name[:LONGEST_NAME]!r} is no recording of {self.folder.name or 'this folder'!r};"
                " choose one of the list"
            )
        return self.opened(str(self.folder / name), name)

    def opened(self, source: str, name: str) -> ViewSource:
        """Return the view of a source that this shelf knows by a name."""
        opener: Callable[..., ViewSource] = (
            open_felt_source if "force" in self.options else open_view_or_events
        )
        return replace(opener(source=source, **self.options), shelf=self, opened=name)


def open_from_shelf(*, source: str, **options: Any) -> ViewSource:
    """Open a recording, and offer those of its folder.

    Args:
        source: An event file or a recording folder.
        **options: As of :func:`~spikingtac.viewer.session.events_only.open_view_or_events`, or with
            ``force`` of :func:`~spikingtac.viewer.session.opening.open_felt_source`.

    Raises:
        SpikingTacError: As there.
    """
    path = Path(source)
    name = path.resolve().name  # of "." and "..", too
    folder = path.parent if path.name == name else path.resolve().parent
    return Shelf(folder=folder, options=options).opened(source, name)
