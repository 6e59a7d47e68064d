"""A slip, what is known of slip at one time, and the alarms that tell it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Phase = Literal["stick", "incipient", "gross"]


@dataclass(frozen=True, slots=True)
class SlipState:
    """How a contact holds at one time.

    Attributes:
        t_us: Time, us.
        sticking_share: Share of the contact's area that sticks, 0 to 1.
        incipient: Probability that part of the contact slips.
        gross: Share of it that slips, 0 to 1, by which gross slip is told.
        phase: What the alarms say: both with hold and hysteresis.
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


@dataclass(frozen=True, kw_only=True)
class AlarmConfig:
    """When an alarm begins and ends.

    Attributes:
        probability: Probability above which it begins.
        hold_us: Time for which it must stay there, us.
        end_share: Share of that probability below which it ends.
    """

    probability: float
    hold_us: int
    end_share: float = 0.5


@dataclass(frozen=True, kw_only=True)
class SlipConfig:
    """When slip is reported.

    Set on 1,180 drawn contacts and 180 held bodies that the model was not fitted to.

    Attributes:
        incipient: Alarm of a contact of which a part slips, on that probability.
        gross: Alarm of a contact of which all slips, on the share that slips.
        settle_us: Time after the begin of a touch in which nothing is told, us (ours: the first
            frames of a touch are as strong as their errors).
    """

    incipient: AlarmConfig = AlarmConfig(probability=0.985, hold_us=0)
    gross: AlarmConfig = AlarmConfig(probability=0.83, hold_us=0)
    settle_us: int = 20_000


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
