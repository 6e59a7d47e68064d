"""Slip from a stream of displacement fields: incipient first, then gross."""

from __future__ import annotations

from dataclasses import replace
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.network import packaged
from spikingtac.touch.slip.stream import FeatureStream
from spikingtac.touch.slip.types import Alarm, Phase, Slip, SlipConfig, SlipState

Field = NDArray[np.float64]

# Sticking share from which on no such alarm begins: the first moments of a motion look like a
# slip, but not like one of much.
INCIPIENT_SHARE = 0.63

# The same where the field has stopped following the body: friction carries no more. A body that
# stops or turns back has that in common with one that slips, so it does not suffice by itself.
STOPPED_PROBABILITY = 0.75

# Share of its speed over 160 ms below which the field's speed over 10 ms says that it has
# stopped.
STOPPED_SHARE = 0.55

# The same where the skin stands still: under a slow twist it moves no further.
STILL_PROBABILITY = 0.93


class SlipEstimate(NamedTuple):
    """What the networks estimate of a contact.

    Attributes:
        share: Share of the contact that sticks, 0 to 1.
        incipient: Probability that part of it slips.
    """

    share: float
    incipient: float


class SlipEstimator:
    """Four recurrent networks on the features of a contact, and the mean of what they tell.

    A body that turns back or stops looks like one that slips, for a moment; what went before tells
    them apart. The networks were trained in different ways and two of them on other contacts, so
    their errors differ. They are fitted to contacts on the twin, whose sticking part is known
    (``scripts/fit_slip_model.py``). A real skin's share has no instrument.
    """

    def __init__(self) -> None:
        """Start without a contact."""
        self._network = packaged("slip.onnx")
        self._step_us = int(self._network.record["step_us"])
        self._initial = np.array(self._network.record["initial"], np.float32)
        self.reset()

    def reset(self) -> None:
        """Forget the contact: nothing has touched for long."""
        self._hidden = self._initial
        self._next_us: int | None = None
        self._estimate = SlipEstimate(1.0, 0.0)

    def update(self, t_us: int, features: Field) -> SlipEstimate:
        """Take in the features ``(FEATURES,)`` of a frame and return the estimate."""
        next_us = t_us if self._next_us is None else self._next_us
        if t_us >= next_us:
            told, self._hidden = self._network(features[None], self._hidden)
            self._estimate = SlipEstimate(*told.tolist())
            next_us = max(next_us + self._step_us, t_us)
        self._next_us = next_us
        return self._estimate


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
        self,
        reference: Field,
        config: SlipConfig | None = None,
        estimator: SlipEstimator | None = None,
    ) -> None:
        """Start without a contact.

        Args:
            reference: ``(m, 2)`` markers at rest, px or mm.
            config: When slip is told.
            estimator: What tells how much sticks; the package's networks unless given.
        """
        self._config = config or SlipConfig()
        self._features = FeatureStream(reference)
        self._estimator = estimator or SlipEstimator()
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
        surely = slips > STILL_PROBABILITY and not self._gross.on
        if self._features.still and self.state is not None and not surely:
            # Nothing new is seen of a skin that stands still: its errors must not ring an alarm.
            self.state = replace(self.state, t_us=t_us)
            return None
        # The share counts where an alarm begins: one slip would ring at each crossing of it.
        may_ring = self._incipient.on or estimate.share < INCIPIENT_SHARE
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
        if self._features.slowing >= log(STOPPED_SHARE):
            return slips
        least = min(STOPPED_PROBABILITY, config.gross.probability)
        return min(slips * config.gross.probability / least, 1.0)

    def _ended(self, t_us: int) -> Slip | None:
        """Return the open slip as one that ends now, and forget it."""
        slip = None
        if self._incipient_us is not None or self._gross_us is not None:
            slip = Slip(self._incipient_us, self._gross_us, t_us, self._least)
            self._forget()
        return slip
