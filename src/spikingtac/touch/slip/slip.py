"""A slip, and what is known of slip at one time."""

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
