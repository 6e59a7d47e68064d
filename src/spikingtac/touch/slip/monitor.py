"""Slip from a stream of displacement fields: incipient first, then gross."""

from __future__ import annotations

from dataclasses import replace
from math import log

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.slip.alarm import Alarm
from spikingtac.touch.slip.feature_stream import FeatureStream
from spikingtac.touch.slip.slip import Phase, Slip, SlipState
from spikingtac.touch.slip.slip_config import SlipConfig
from spikingtac.touch.slip.slip_model import SlipEstimate, SlipModel, default_model

Field = NDArray[np.float64]


class SlipMonitor:
    """Watches one sensor's contact and reports its slips, causally.

    Example:
        >>> touches = TouchDetector(reference_px)  # doctest: +SKIP
        >>> monitor = SlipMonitor(reference_px)  # doctest: +SKIP
        >>> for frame in frames:  # doctest: +SKIP
        ...     touches.update(frame)
        ...     slip = monitor.update(frame.t_us, touches.tracked_px, touches.touching)
        ...     print(monitor.state)

    Attributes:
        state: What is known of the contact now; None while nothing touches, in the first
            ``settle_us`` of a touch, and where frames are too far apart.
        tells: Whether the last two frames were near enough to each other to tell slip (6 ms).
    """

    def __init__(
        self, reference: Field, config: SlipConfig | None = None, model: SlipModel | None = None
    ) -> None:
        """Start without a contact.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.
            config: When slip is told.
            model: From features to what sticks; the package's own unless given.
        """
        self._config = config or SlipConfig()
        self._features = FeatureStream(reference)
        self._estimator = (model or default_model()).estimator()
        self._incipient = Alarm(self._config.incipient)
        self._gross = Alarm(self._config.gross)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state: SlipState | None = None
        self.tells = False
        self._features.reset()
        self._estimator.reset()
        self._touched_us: int | None = None
        self._forget()

    def _forget(self) -> None:
        """Forget the open slip."""
        self._incipient.reset()
        self._gross.reset()
        self._incipient_us: int | None = None
        self._gross_us: int | None = None
        self._least = 1.0

    def update(self, t_us: int, displacement: Field, touching: bool) -> Slip | None:
        """Take in a frame and return the slip that it ends, if any.

        Args:
            t_us: Time, us.
            displacement: ``(m, 2)`` markers from the rest that they had before the touch, in the
                unit of the reference.
            touching: Whether something touches (:class:`TouchDetector`).
        """
        features = self._features.update(t_us, displacement)
        self.tells = features is not None
        if not touching:
            self._touched_us = None
        elif self._touched_us is None:
            self._touched_us = t_us
        if features is None or self._touched_us is None:
            self._estimator.reset()
            self.state = None
            return self._ended(t_us)
        estimate = self._estimator.update(t_us, features)
        if t_us - self._touched_us < self._config.settle_us:
            self.state = None
            return None
        return self._told(t_us, estimate)

    def finish(self, t_us: int) -> Slip | None:
        """Return the slip that is still open at the end, us."""
        return self._ended(t_us)

    def _told(self, t_us: int, estimate: SlipEstimate) -> Slip | None:
        slips = 1.0 - estimate.share
        surely = slips > self._config.still_probability and not self._gross.on
        if self._features.still and self.state is not None and not surely:
            # Nothing new is seen of a skin that stands still: its errors must not ring an alarm.
            self.state = replace(self.state, t_us=t_us)
            return None
        # The share counts where an alarm begins: one slip would ring at each crossing of it.
        may_ring = self._incipient.on or estimate.share < self._config.incipient_share
        part = estimate.incipient if may_ring else 0.0
        if self._incipient.update(t_us, part) and self._gross_us is None:
            self._incipient_us = t_us if self._incipient_us is None else self._incipient_us
        if self._gross.update(t_us, self._gross_evidence(slips)) and self._gross_us is None:
            self._gross_us = t_us
        slipping = self._incipient.on or self._gross.on
        phase: Phase = "gross" if self._gross.on else "incipient" if self._incipient.on else "stick"
        self.state = SlipState(t_us, estimate.share, estimate.incipient, slips, phase)
        if slipping:
            self._least = min(self._least, estimate.share)
            return None
        return self._ended(t_us)

    def _gross_evidence(self, slips: float) -> float:
        """Return the share that slips; more of it where the field has stopped following."""
        config = self._config
        if self._features.slowing >= log(config.stopped_share):
            return slips
        least = min(config.stopped_probability, config.gross.probability)
        return min(slips * config.gross.probability / least, 1.0)

    def _ended(self, t_us: int) -> Slip | None:
        """Return the open slip as one that ends now, and forget it."""
        slip = None
        if self._incipient_us is not None or self._gross_us is not None:
            slip = Slip(self._incipient_us, self._gross_us, t_us, self._least)
            self._forget()
        return slip
