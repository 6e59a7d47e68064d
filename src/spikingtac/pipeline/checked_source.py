"""A source of events that reports when they do not fit the calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.errors import CalibrationError
from spikingtac.events.source import EventSource
from spikingtac.markers.calibration_check import CalibrationCheck
from spikingtac.types import EventPacket, LossCounters


class CheckedSource:
    """Passes packets on and compares them with a calibration meanwhile.

    Every attribute that is not named here is the source's own (``path``, ``progress``, ``close``).

    Args:
        source: Where the events come from.
        calibration: What they are tracked with.
        tell: Called once with a sentence where they contradict it; what it raises ends the stream.

    Attributes:
        misfit: That sentence, or None.
    """

    size: tuple[int, int]
    losses: LossCounters

    def __init__(
        self,
        source: EventSource,
        calibration: Calibration,
        tell: Callable[[str], None] = lambda why: None,
    ) -> None:
        self._source, self._calibration, self._tell = source, calibration, tell
        self.misfit: str | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # copies ask before there is a source
            raise AttributeError(name)
        return getattr(self._source, name)

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the source's packets."""
        check = CalibrationCheck(self._calibration)
        for packet in self._source:
            if not check.ended:
                check.absorb(packet)
                self._judge(check)
            yield packet
        if not check.ended:
            check.finish()
            self._judge(check)

    def _judge(self, check: CalibrationCheck) -> None:
        if check.foreign and self.misfit is None:
            self.misfit = check.words()
            self._tell(self.misfit)


def refuse(why: str) -> None:
    """Refuse a calibration that does not fit.

    Raises:
        CalibrationError: Always, with the reason.
    """
    raise CalibrationError(why)
