"""The exported stretch of a view: its events on disk, tracked as fast as the machine can."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from spikingtac.errors import ConfigError
from spikingtac.types import EventPacket
from spikingtac.viewer.event_store import EventStore
from spikingtac.viewer.playback import Playback
from spikingtac.viewer.session.source import ViewSource

EXPOSURE_US = 30_000
"""Events of the last two frames of an ordinary camera, as on the page."""
US_PER_S = 1_000_000
_BUDGET_S = 3600.0  # no step is cut off


@dataclass(frozen=True, slots=True)
class Stretch:
    """A view that is tracked from its beginning to a given end.

    Attributes:
        view: What is exported.
        playback: Tracks it.
        end_us: End of the stretch, us.
    """

    view: ViewSource
    playback: Playback
    end_us: int

    def advance(self, step_us: int) -> int:
        """Track on by a step, at most to the end; return how far it went, us.

        A silence that is too long to be filled counts as one step.
        """
        before_us = self.playback.position_us
        target_us = max(before_us + step_us, self.playback.resumes_us(before_us + step_us) or 0)
        self.playback.aim(min(target_us, self.end_us))
        self.playback.work(_BUDGET_S)
        return self.playback.position_us - before_us

    def exposed(self) -> EventPacket:
        """Return the events of the last exposure."""
        now_us = self.playback.position_us
        return self.playback.store.between(now_us - EXPOSURE_US, now_us)


@contextmanager
def open_stretch(view: ViewSource, seconds: float | None) -> Iterator[Stretch]:
    """Open a stretch of a view; its temporary files go with the context.

    Args:
        view: What is exported.
        seconds: Length from the beginning; None is all of it.

    Raises:
        ConfigError: The source does not end by itself and no length was given.
    """
    if seconds is None and not view.ends:
        raise ConfigError("this source does not end by itself; give a length: --seconds N")
    store = EventStore(view.source)
    try:
        if view.ends:
            store.extend_to_end()
        end_us = store.t_end_us
        if seconds is not None:
            asked_us = store.t_start_us + round(seconds * US_PER_S)
            end_us = min(asked_us, end_us) if view.ends else asked_us
        playback = Playback(
            store, lambda: view.make_tracker(view.config), view.make_detector, rate_hz=view.rate_hz
        )
        yield Stretch(view, playback, end_us)
    finally:
        store.close()
