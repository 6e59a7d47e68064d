"""What can be changed while a sensor is published, and how it is changed between two frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from spikingtac.errors import ConfigError
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.touch.touches.touch_config import TouchConfig
from spikingtac.tuning import Control, controls, in_use, with_value

TRACKING = "tracking"


@dataclass(frozen=True, kw_only=True, slots=True)
class RateConfig:
    """How often what is sent.

    Attributes:
        field_hz: Fields and wrenches per second, at most as many as there are frames.
        arrows_hz: Arrows per second (ours: 30, what a display shows).
    """

    field_hz: float = field(
        default=10_000.0,
        metadata={
            "range": (1.0, 10_000.0),
            "about": "fields and wrenches per second; at most every frame is sent",
        },
    )
    arrows_hz: float = field(
        default=30.0, metadata={"range": (1.0, 240.0), "about": "arrows per second"}
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveConfig:
    """What can be changed while it runs.

    Attributes:
        publish: How often what is sent.
        contact: When a touch begins and ends.
        tracking: How markers are followed, None where they are not: tracks.
    """

    publish: RateConfig = field(default_factory=RateConfig)
    contact: TouchConfig = field(default_factory=TouchConfig)
    tracking: TrackingConfig | None = None


class Settings:
    """The settings of one publisher; requested in one thread, applied in another.

    Args:
        config: What holds at first.
        fixed: What can be read but not changed, by name.
        prepare: Makes ready what a change of the tracking needs; what it returns is called between
            two frames.
    """

    def __init__(
        self,
        config: LiveConfig,
        fixed: Mapping[str, str | float] | None = None,
        prepare: Callable[[TrackingConfig], Callable[[], None]] | None = None,
    ) -> None:
        self.config, self._prepare = config, prepare
        self.fixed = dict(fixed or {})
        self._changes: deque[Callable[[], None]] = deque()
        self._watchers: list[Callable[[LiveConfig], None]] = []

    def controls(self) -> Iterator[Control]:
        """Yield what can be changed, with present values and valid ranges."""
        yield from controls(self.config.publish, "publish.")
        yield from controls(self.config.contact, "contact.")
        if self.config.tracking is not None and self._prepare is not None:
            for control in in_use(self.config.tracking):
                yield replace(control, name=f"{TRACKING}.{control.name}")

    def watch(self, changed: Callable[[LiveConfig], None]) -> None:
        """Have a function called, between two frames, with what holds after a change."""
        self._watchers.append(changed)

    def set(self, values: Mapping[str, Any]) -> None:
        """Change all of these settings, or none.

        Raises:
            ConfigError: A name is unknown or fixed, or a value is not valid.
        """
        config = self.config
        known = {control.name for control in self.controls()}
        for name, value in values.items():
            if name in self.fixed:
                raise ConfigError(f"{name!r} is fixed while this sensor is published")
            if name not in known:
                raise ConfigError(f"{name!r} is no setting; ask for a list of them")
            config = with_value(config, name, value)
        if config.tracking is not None and config.tracking != self.config.tracking:
            assert self._prepare is not None  # otherwise nothing of the tracking is known
            self._changes.append(self._prepare(config.tracking))
        self.config = config
        self._changes.append(lambda: self._tell(config))

    def later(self, change: Callable[[], None]) -> None:
        """Have something done between two frames."""
        self._changes.append(change)

    def apply(self) -> None:
        """Apply what was requested since the last frame; called by the publishing thread."""
        while self._changes:
            self._changes.popleft()()

    def _tell(self, config: LiveConfig) -> None:
        for changed in self._watchers:
            changed(config)
