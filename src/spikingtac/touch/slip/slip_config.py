"""When a probability of slip becomes an alarm: the settings of the slip monitor."""

from __future__ import annotations

from dataclasses import dataclass


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

    def __post_init__(self) -> None:
        if not 0.0 < self.probability < 1.0:
            raise ValueError(f"probability is {self.probability}, valid is between 0 and 1")
        if self.hold_us < 0 or not 0.0 < self.end_share <= 1.0:
            raise ValueError("hold_us must not be negative, end_share must be in (0, 1]")


@dataclass(frozen=True, kw_only=True)
class SlipConfig:
    """When slip is reported.

    Set on 1,180 drawn contacts and 180 held bodies that the model was not fitted to.

    Attributes:
        incipient: Alarm of a contact of which a part slips, on that probability.
        incipient_share: Sticking share from which on no such alarm begins: the first moments of a
            motion look like a slip, but not like one of much.
        gross: Alarm of a contact of which all slips, on the share that slips.
        stopped_probability: The same where the field has stopped following the body: friction
            carries no more. A body that stops or turns back has that in common with one that slips,
            so it does not suffice by itself.
        stopped_share: Share of its speed over 160 ms below which the field's speed over 10 ms says
            that it has stopped.
        still_probability: The same where the skin stands still: under a slow twist it moves no
            further.
        settle_us: Time after the begin of a touch in which nothing is told, us (ours: the first
            frames of a touch are as strong as their errors).
    """

    incipient: AlarmConfig = AlarmConfig(probability=0.985, hold_us=0)
    incipient_share: float = 0.63
    gross: AlarmConfig = AlarmConfig(probability=0.83, hold_us=0)
    stopped_probability: float = 0.75
    stopped_share: float = 0.55
    still_probability: float = 0.93
    settle_us: int = 20_000

    def __post_init__(self) -> None:
        for name in (
            "incipient_share",
            "stopped_probability",
            "stopped_share",
            "still_probability",
        ):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}, valid is between 0 and 1")
        if self.settle_us < 0:
            raise ValueError(f"settle_us is {self.settle_us}, it must not be negative")
