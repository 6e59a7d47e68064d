"""An alarm on a probability: it begins after a hold and ends well below where it began."""

from __future__ import annotations

from spikingtac.touch.slip.slip_config import AlarmConfig


class Alarm:
    """One alarm.

    Attributes:
        on: True while the alarm is given.
    """

    def __init__(self, config: AlarmConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Take the alarm back."""
        self.on = False
        self._above_us: int | None = None

    def update(self, t_us: int, probability: float) -> bool:
        """Take in a probability and return whether the alarm begins now."""
        config = self._config
        if self.on:
            self.on = probability > config.end_share * config.probability
            self._above_us = None
            return False
        if probability <= config.probability:
            self._above_us = None
            return False
        if self._above_us is None:
            self._above_us = t_us
        self.on = t_us - self._above_us >= config.hold_us
        return self.on
