"""Slip from a stream of displacement fields: incipient first, then gross."""

from dataclasses import dataclass, replace
from math import log
from typing import Literal

import numpy as np

from spikingtac.touch.network import packaged
from spikingtac.touch.slip.features import FeatureStream
from spikingtac.types import FloatArray

Phase = Literal["stick", "incipient", "gross"]

# The alarms were set on 1,180 drawn contacts and 180 held bodies that the model was not fitted to.
# Probability that part of a contact slips above which an incipient slip begins.
INCIPIENT_PROBABILITY = 0.985

# Sticking share from which on none begins: the first moments of a motion look like a slip, but not
# like one of much.
INCIPIENT_SHARE = 0.63
GROSS_SHARE = 0.83  # Share of a contact that slips above which a gross slip begins.
END_SHARE = 0.5  # Share of either below which the slip ends.

# Share that suffices where the field has stopped following the body: friction carries no more. A
# body that stops or turns back has that in common with one that slips.
STOPPED_PROBABILITY = 0.75

# Share of its speed over 160 ms below which the field's speed over 10 ms says that it has
# stopped.
STOPPED_SHARE = 0.55

# Share that is needed where the skin stands still: under a slow twist it moves no further.
STILL_PROBABILITY = 0.93

# Time after the begin of a touch in which nothing is told, us: the first frames of a touch are as
# strong as their errors.
SETTLE_US = 20_000


@dataclass(frozen=True, slots=True)
class SlipState:
    """How a contact holds at one time.

    Attributes:
        t_us: Time, us.
        sticking_share: Share of the contact's area that sticks, 0 to 1.
        incipient: Probability that part of the contact slips.
        gross: Share of it that slips, 0 to 1, by which gross slip is told.
        phase: What the alarms say, with hysteresis.
    """

    t_us: int
    sticking_share: float
    incipient: float
    gross: float
    phase: Phase


@dataclass(frozen=True, slots=True)
class Slip:
    """A slip from its first sign to its end.

    Attributes:
        incipient_us: When part of the contact was noticed to slip, us: ``gross_us`` where that was
            noticed together with the slip of all of it; None where it was noticed later, or never.
        gross_us: When the whole contact was noticed to slip, us; None where it never did.
        end_us: When the contact held again or ended, us.
        least_sticking_share: Smallest share of the contact that stuck, 0 to 1.
    """

    incipient_us: int | None
    gross_us: int | None
    end_us: int
    least_sticking_share: float

    @property
    def lead_us(self) -> int | None:
        """Time by which the incipient slip announced the gross one, us; 0 where both came at once.

        None without both.
        """
        if self.incipient_us is None or self.gross_us is None:
            return None
        return self.gross_us - self.incipient_us


class SlipMonitor:
    """Watches one sensor's contact and reports its slips, causally.

    Four recurrent networks tell the share that sticks and the probability of a slip from the
    features of a contact; the mean counts. A body that turns back or stops looks like one that
    slips, for a moment; what went before tells them apart. The networks were trained in different
    ways and two of them on other contacts, so their errors differ. They are fitted to contacts on
    the twin, whose sticking part is known (``scripts/fit_slip_model.py``). A real skin's share has
    no instrument.

    Example:
        >>> touches = TouchDetector(reference_px)  # doctest: +SKIP
        >>> monitor = SlipMonitor(reference_px)  # doctest: +SKIP
        >>> for frame in frames:  # doctest: +SKIP
        ...     touches.update(frame)
        ...     slip = monitor.update(frame.t_us, touches.tracked_px, touches.touching)
        ...     print(monitor.state)

    Attributes:
        state: What is known of the contact now; None while nothing touches, in the first 20 ms of
            a touch, and where frames are too far apart.
        tells: Whether the last two frames were near enough to each other to tell slip (6 ms).
    """

    def __init__(self, reference: FloatArray) -> None:
        """Start without a contact; ``reference`` are the markers ``(m, 2)`` at rest, px or mm."""
        self._features = FeatureStream(reference)
        self._network = packaged("slip.onnx")
        self._step_us = int(self._network.record["step_us"])
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.state: SlipState | None
        self.tells = False
        self._features.reset()
        self._touched_us: int | None = None
        self._leave()
        self._forget()

    def _leave(self) -> None:
        """Forget the contact: nothing has touched for long."""
        self._hidden = np.array(self._network.record["initial"])
        self._next_us: int | None = None
        self._estimate = 1.0, 0.0
        self.state = None

    def _forget(self) -> None:
        """Forget the open slip."""
        self._part_slips = self._all_slips = False
        self._incipient_us: int | None = None
        self._gross_us: int | None = None
        self._least = 1.0

    def update(self, t_us: int, displacement: FloatArray, touching: bool) -> Slip | None:
        """Take in a frame and return the slip that it ends, if any.

        Args:
            t_us: Time, us.
            displacement: ``(m, 2)`` markers from the rest that they had before the touch, in the
                unit of the reference.
            touching: Whether something touches (:class:`TouchDetector`).
        """
        due = self._next_us is None or t_us >= self._next_us
        features = self._features.update(t_us, displacement, touching, due)
        self.tells = self._features.known
        if not touching:
            self._touched_us = None
        elif self._touched_us is None:
            self._touched_us = t_us
        if not self.tells or self._touched_us is None:
            self._leave()
            return self.finish(t_us)
        if features is not None:
            self._follow(t_us, features)
        if t_us - self._touched_us < SETTLE_US:
            self.state = None
            return None
        return self._told(t_us, *self._estimate)

    def _follow(self, t_us: int, features: FloatArray) -> None:
        """Take in the features ``(FEATURES,)`` that are due: networks step at their own rate."""
        told, self._hidden = self._network(features[None], self._hidden)
        share, incipient = told.tolist()
        self._estimate = share, incipient
        due_us = t_us if self._next_us is None else self._next_us
        self._next_us = max(due_us + self._step_us, t_us)

    def finish(self, t_us: int) -> Slip | None:
        """Return the open slip as one that ends at a time, us, and forget it."""
        slip = None
        if self._incipient_us is not None or self._gross_us is not None:
            slip = Slip(self._incipient_us, self._gross_us, t_us, self._least)
            self._forget()
        return slip

    def _told(self, t_us: int, share: float, incipient: float) -> Slip | None:
        slips = 1.0 - share
        surely = slips > STILL_PROBABILITY and not self._all_slips
        if self._features.still and self.state is not None and not surely:
            # Nothing new is seen of a skin that stands still: its errors must not ring an alarm.
            self.state = replace(self.state, t_us=t_us)
            return None
        # The share counts where an alarm begins: one slip would ring at each crossing of it.
        begins = share < INCIPIENT_SHARE and incipient > INCIPIENT_PROBABILITY
        goes_on = incipient > END_SHARE * INCIPIENT_PROBABILITY
        part_slips = goes_on if self._part_slips else begins
        if part_slips and not self._part_slips and self._gross_us is None:
            self._incipient_us = t_us if self._incipient_us is None else self._incipient_us
        evidence = slips
        if self._features.slowing < log(STOPPED_SHARE):
            evidence = min(slips * GROSS_SHARE / STOPPED_PROBABILITY, 1.0)
        all_slips = evidence > GROSS_SHARE * (END_SHARE if self._all_slips else 1.0)
        if all_slips and not self._all_slips and self._gross_us is None:
            self._gross_us = t_us
        self._part_slips, self._all_slips = part_slips, all_slips
        phase: Phase = "gross" if all_slips else "incipient" if part_slips else "stick"
        self.state = SlipState(t_us, share, incipient, slips, phase)
        if phase == "stick":
            return self.finish(t_us)
        self._least = min(self._least, share)
        return None
