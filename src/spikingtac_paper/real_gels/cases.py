"""Which recordings the experiment reads, how each is calibrated, and what is known about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

FOLDER = "gel"
"""Folder of these recordings below that of the foreign recordings."""

SIMULATED, V2E, RECORDED = "simulated", "v2e", "recorded"
"""Where the events come from: a transparent model, the simulator v2e, or a real sensor."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GelCase:
    """One recording and one way to calibrate its sensor.

    Attributes:
        name: Of the rows in ``report.json``.
        events: File to track.
        slides: File to calibrate from; None calibrates from :attr:`events` itself.
        truth: File with the true course of the markers, or None.
        reference: File with the standing places of the markers between the bursts, or None.
        source: Where the events come from.
    """

    name: str
    events: str
    slides: str | None = None
    truth: str | None = None
    reference: str | None = None
    source: str

    @property
    def calibrated_from(self) -> str:
        """File that the calibration is made from."""
        return self.slides or self.events

    def files(self) -> tuple[str, ...]:
        """Return every file that the case needs."""
        named = (self.events, self.slides, self.truth, self.reference)
        return tuple(name for name in named if name)

    def is_there(self, folder: Path) -> bool:
        """Return whether all files of the case are in a folder."""
        return all((folder / name).is_file() for name in self.files())


CASES: tuple[GelCase, ...] = (
    GelCase(
        name="real-presses",
        events="real_presses.aedat4",
        reference="real_presses.reference.npz",
        source=RECORDED,
    ),
    GelCase(
        name="sim-presses/slides",
        events="sim_presses.raw",
        slides="sim_presses_bootstrap.raw",
        truth="sim_presses.truth.npz",
        source=SIMULATED,
    ),
    GelCase(
        name="sim-presses/itself",
        events="sim_presses.raw",
        truth="sim_presses.truth.npz",
        source=SIMULATED,
    ),
    GelCase(
        name="gel/slides",
        events="gel.raw",
        slides="gel_bootstrap.raw",
        truth="gel.truth.npz",
        source=V2E,
    ),
    GelCase(name="gel/itself", events="gel.raw", truth="gel.truth.npz", source=V2E),
)
"""All cases, the real recording first."""
