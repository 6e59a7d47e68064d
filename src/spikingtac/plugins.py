"""Parts that other packages add: trackers, contact detectors, event formats, cameras.

A package registers a part under an entry point group of its ``pyproject.toml``, and it can be
named wherever one of this package's own can. The how-to pages ``add-a-tracker.md``,
``add-a-detector.md``, ``add-a-format.md`` and ``add-a-camera.md`` show each kind.
"""

from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import metadata
from typing import TypeVar

from spikingtac.errors import ConfigError

T = TypeVar("T")

# Group of trackers: builder ``(TrackingConfig, Calibration, OutputLaw) -> MarkerTracker``.
TRACKERS = "spikingtac.trackers"

# Group of contact detectors: the builder of :mod:`spikingtac.contact.registry`.
DETECTORS = "spikingtac.contact_detectors"

# Group of cameras: the kind in an address -> a class like ``spikingtac.cameras.camera.Camera``.
CAMERAS = "spikingtac.cameras"

# Group of event formats to read: the ending without its dot -> a class like ``FileSource``.
READERS = "spikingtac.readers"

# Group of event formats to write: the same -> ``(path, size) -> EventWriter``.
WRITERS = "spikingtac.writers"

# Group of sensor designs: ``design`` -> ``(Scene, name) -> Scene``, the scene on that sensor.
SCENE_DESIGNS = "spikingtac.scene_designs"


class WithPlugins(Mapping[str, T]):
    """This package's entries together with those that other packages register under a group.

    A plug-in is imported when it is asked for; a name of this package cannot be replaced.

    Args:
        own: Name -> entry.
        group: Entry point group, as ``spikingtac.trackers``.
    """

    def __init__(self, own: Mapping[str, T], group: str) -> None:
        self._own, self._group = own, group

    @cached_property
    def _plugins(self) -> dict[str, metadata.EntryPoint]:
        # Only where it is asked for: a look at every installed package takes 6 ms.
        return {point.name: point for point in metadata.entry_points(group=self._group)}

    def __getitem__(self, name: str) -> T:
        if name in self._own:
            return self._own[name]
        point = self._plugins[name]
        try:
            return point.load()
        except Exception as error:  # whatever a foreign module raises while it is imported
            package = point.dist.name if point.dist else "unknown"
            raise ConfigError(
                f"{name!r} of the package {package!r} cannot be loaded ({point.value}): {error}; "
                "update or remove that package"
            ) from error

    def __iter__(self) -> Iterator[str]:
        yield from self._own
        yield from (name for name in self._plugins if name not in self._own)

    def __len__(self) -> int:
        return len({*self._own, *self._plugins})


def origin(group: str, name: str) -> str:
    """Return the package, its version and the object behind a plug-in, for reports and digests.

    Raises:
        ConfigError: No package registers that name under the group.
    """
    for point in metadata.entry_points(group=group, name=name):
        package = f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"
        return f"{package}, {point.value}"
    raise ConfigError(f"no package registers {name!r} under {group!r}")
