"""What can be changed while a sensor is published."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from spikingtac.errors import ConfigError
from spikingtac.markers.tracking_config import TrackingConfig
from spikingtac.ros2.settings import LiveConfig, Settings


def test_changes_wait_until_they_are_applied() -> None:
    settings, seen = Settings(LiveConfig()), []
    settings.watch(seen.append)
    settings.set({"publish.field_hz": 50, "contact.noise_factor": 3.0})
    assert seen == []
    assert settings.config.publish.field_hz == 50.0  # who asks is told the new value at once
    settings.apply()
    settings.apply()
    (now,) = seen
    assert (now.publish.field_hz, now.contact.noise_factor) == (50.0, 3.0)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"publish.field_hz": 0.5}, "1 to 10000"),
        ({"publish.field_hz": "fast"}, "1 to 10000"),
        ({"publish.fields_hz": 5.0}, "no setting"),
        ({"source": "b"}, "fixed"),
        ({"tracking.hysteresis": "anchored"}, "no setting"),
        ({"publish.field_hz": 5.0, "publish.arrows_hz": -1.0}, "1 to 240"),
    ],
)
def test_what_is_refused_changes_nothing(values: dict[str, object], why: str) -> None:
    settings, seen = Settings(LiveConfig(), {"source": "a"}), []
    settings.watch(seen.append)
    with pytest.raises(ConfigError, match=why):
        settings.set(values)
    settings.apply()
    assert settings.config == LiveConfig()
    assert seen == []


def test_another_tracker_is_made_when_asked_and_takes_over_when_applied() -> None:
    made, taken = [], []

    def prepare(tracking: TrackingConfig) -> Callable[[], None]:
        made.append(tracking.hysteresis)
        return lambda: taken.append(tracking.hysteresis)

    settings = Settings(LiveConfig(tracking=TrackingConfig()), prepare=prepare)
    names = {control.name for control in settings.controls()}
    assert "tracking.hysteresis" in names
    assert not {name for name in names if name.startswith("tracking.blobs")}  # not in use
    settings.set({"tracking.hysteresis": "anchored"})
    assert (made, taken) == (["anchored"], [])
    settings.apply()
    assert taken == ["anchored"]
    settings.set({"contact.end_share": 0.3})  # touches nothing of the tracking
    settings.apply()
    assert made == ["anchored"]


def test_what_is_to_be_done_later_is_done_in_order() -> None:
    settings, done = Settings(LiveConfig()), []
    settings.later(lambda: done.append(1))
    settings.later(lambda: done.append(2))
    settings.apply()
    assert done == [1, 2]
