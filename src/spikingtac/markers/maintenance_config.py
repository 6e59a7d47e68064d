"""What a tracker on the graded map does beside locating: settings."""

from __future__ import annotations

from dataclasses import dataclass, field

from spikingtac.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class MaintenanceConfig:
    """What the tracker does beside locating, for every locator.

    Attributes:
        longest_period_us: Longest time between estimates, us; where they are asked for more rarely,
            some are made in between; 0 makes none (ours: at 2 ms the tracks are as accurate as at
            1 ms; at 30 ms they lose markers).
        period_us: Period of each maintenance task, us; 0 runs all of them at every estimate (ours:
            at 4 ms the tracks are as accurate as at 1 ms, and at 1 kHz each step runs one task).
        leak_per_s: Rate at which map pixels give up their disagreement with the disc, 1/s. It cures
            what noise and lost events leave in the map (ours).
        leak_tolerance: Disagreement that is left alone in a stream that is known to be whole, in
            mean steps of the marker (ours).
        lossy_leak_tolerance: The same before enough motion was seen, and where most events are
            lost; in between where some are. A disc that lags behind its marker for want of events
            must not erase the map's evidence of it (ours).
        leak_reach_px: How far outside of a disc the leak works, px (ours).
        outline_return_per_s: Rate at which the edges of resting discs return to their calibrated
            outlines, 1/s (ours: over fifty contacts on a training seed the error stays at 0.12 px;
            without it it grows to 0.15 px, and the radii by 0.35 px).
        ground_return_per_s: Rate at which the ground away from all discs returns to its level, 1/s;
            0 leaves it (ours: what noise adds up there draws a disc that comes near; 0.3 to 10 are
            alike within 1 %).
        leak_groups: The leak visits every n-th marker per round, in turn: less work, same effect.
        lag_us: Delay of the events behind the motion, us; None takes the calibration's.
        backlash: By how much a fit stays behind its marker in steady motion, as a share of the way
            in which an edge crosses one step (ours: on the training scenes 0.05 to 0.2 are alike
            within 1 %).
        turn_backlash: By how much more it stays behind just after the marker turned round (ours:
            chosen on the training scenes; both together shrink their errors by 5 %).
        shrink_px: Difference from the neighbours' prediction that is as likely an error of the fit
            as deformation, px (ours, on the training scenes and others like v2e's: 0.1 and 0.15 are
            alike; with ``shrink_crossings`` their errors shrink by 8 and 15 %).
        shrink_crossings: How much more it is, in the ways in which an edge crosses one step.
        adapt_to_loss: Whether steps grow when fewer events arrive than the motion asks for.
    """

    longest_period_us: int = 2_000
    period_us: int = 4_000
    leak_per_s: float = field(default=30.0, metadata={"range": (0.0, 100.0), "unit": "1/s"})
    leak_tolerance: float = field(default=0.3, metadata={"range": (0.0, 3.0)})
    lossy_leak_tolerance: float = field(
        default=1.0, metadata={"range": (0.0, 3.0), "former_names": ("wary_tolerance",)}
    )
    leak_reach_px: float = 3.5
    outline_return_per_s: float = field(
        default=0.3,
        metadata={"range": (0.0, 10.0), "unit": "1/s", "former_names": ("ease_per_s",)},
    )
    ground_return_per_s: float = field(default=0.3, metadata={"range": (0.0, 10.0), "unit": "1/s"})
    leak_groups: int = 8
    lag_us: float | None = None
    backlash: float = field(default=0.15, metadata={"range": (0.0, 1.0)})
    turn_backlash: float = field(default=0.3, metadata={"range": (0.0, 1.0)})
    shrink_px: float = field(default=0.1, metadata={"range": (0.0, 1.0), "unit": "px"})
    shrink_crossings: float = field(default=0.3, metadata={"range": (0.0, 1.0)})
    adapt_to_loss: bool = field(default=True, metadata={"range": (0, 1)})

    def __post_init__(self) -> None:
        rates = ("leak_per_s", "outline_return_per_s", "ground_return_per_s")
        tolerances = ("leak_tolerance", "lossy_leak_tolerance")
        plays = ("backlash", "turn_backlash", "shrink_px", "shrink_crossings")
        for name in (
            "longest_period_us",
            "period_us",
            *rates,
            *tolerances,
            "leak_reach_px",
            *plays,
        ):
            if getattr(self, name) < 0:
                raise ConfigError(f"{name} is {getattr(self, name)}, it must not be negative")
        if self.leak_groups < 1:
            raise ConfigError(f"leak_groups is {self.leak_groups}, it must be at least 1")
