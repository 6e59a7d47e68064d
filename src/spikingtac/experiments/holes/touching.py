"""The touches of the hole experiment: calibration on a flat wall, then two searches per hole.

A search is a chain, in which each touch depends on all before; so both searches of a hole are made
once, and every method, and both repeatabilities of the arm, are read from their touches.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.contact.detector import ContactDetector
from spikingtac.contact.registry import DetectionConfig, make_detector
from spikingtac.errors import SearchError
from spikingtac.experiments.harness.fingerprint import code_digest
from spikingtac.experiments.harness.quiet_windows import load_windows, save_windows
from spikingtac.experiments.harness.run_folder import write_json
from spikingtac.experiments.holes.readings import PLANNING_MM, RecordingProber, touched_of
from spikingtac.geometry.travel import TravelModel, fit_travel
from spikingtac.robot.adaptive_search import AdaptiveSearch, AdaptiveSearchConfig
from spikingtac.robot.arm import ArmState
from spikingtac.robot.cross_search import cross_search
from spikingtac.robot.prober import ArmProber, Prober, ProbingConfig, Touched
from spikingtac.sim.rig.hole_site import Grasp, HoleSite, HoleTrial, flat_wall, hole_trial
from spikingtac.types import EventPacket

Vector = NDArray[np.float64]

RADII_MM: tuple[float, ...] = tuple(round(0.7 + 4.3 / 9 * k, 3) for k in range(10))
"""Ten radii from 0.7 to 5.0 mm (Section V-C names the range)."""
PITCH_MM = 15.0
COLUMNS = 5
"""The plate: two rows of five holes."""
CORNER_MM = 0.75 / np.sqrt(3.0)
"""Largest radius of the bit, mm: the start lies within 0.9 of what it leaves free."""
CROSS, DEFAULT = "cross", "default"
STYLES = {CROSS: ProbingConfig(), DEFAULT: ProbingConfig.conditioned()}
"""How each search touches."""
MOST_CONTACTS = 12
ANGLES_DEG = {
    CROSS: (0.0, 180.0, 90.0, 270.0),
    DEFAULT: tuple(
        way + side * step for way in (0, 180) for side in (-1, 1) for step in (17, 34, 51)
    ),
}
"""Directions of the calibration: those of the cross, and the sector of the adaptive search, evenly:
twelve tell travel and heading apart."""
CYCLES = {CROSS: 4, DEFAULT: 10}
"""Touches of each direction in a calibration; at most 10 are allowed. Its error is common to all
contacts of a seed: with sixty touches it was a seventh of the variance of a centre from twelve
contacts."""
QUICK_CYCLES = {CROSS: 2, DEFAULT: 3}
"""The same in a quick run, whose one calibration no second worker shares."""
WALL_MM = 1.0
"""Distance of the calibration's wall from where the bit stands, mm."""
QUIET_WINDOWS = 4000
QUIET_SPEED_MM_S = 3.0
DETECTOR = "default"
HOLE_SEEDS, CALIBRATION_SEEDS = 1000, 500
"""Noise seeds of a hole and of a calibration, per experiment seed."""
PAST_STREAM = 6
"""Number of the random stream of the contacts before."""
CODE = (
    "sim", "contact", "robot", "geometry", "configs/cameras",
    "experiments/holes/readings.py", "experiments/holes/touching.py",
)  # fmt: skip
"""What a touch depends on."""


@dataclass(frozen=True, slots=True)
class HoleWork:
    """One hole of one seed; ``hole`` None is the seed's calibration.

    Attributes:
        folder: The run's folder.
        seed: Of grasp, plate and noise.
        hole: Which of :data:`RADII_MM`.
        detector: Name of the contact detector.
        quick: Whether :data:`QUICK_CYCLES` must do.
    """

    folder: Path
    seed: int
    hole: int | None = None
    detector: str = DETECTOR
    quick: bool = False

    @property
    def cycles(self) -> dict[str, int]:
        """Touches of each direction in the calibration, by style."""
        return QUICK_CYCLES if self.quick else CYCLES

    @property
    def path(self) -> Path:
        """Where the touches are kept."""
        name = "calibration" if self.hole is None else f"hole-{self.hole + 1}"
        return self.folder / "touches" / f"seed-{self.seed}" / f"{name}.json"


def travel_of(kept: Sequence[dict[str, Any]], sigma_mm: float) -> TravelModel:
    """Return the calibration from touches of flat walls at :data:`WALL_MM`."""
    touches = [touched_of(one, sigma_mm) for one in kept]
    excess = [float(touch.reading_mm @ touch.direction) - WALL_MM for touch in touches]
    angle = [float(np.arctan2(touch.direction[1], touch.direction[0])) for touch in touches]
    return fit_travel(np.array(angle), np.array(excess))


def trial_of(seed: int, hole: int) -> HoleTrial:
    """Return a hole of a seed's plate, and where the search begins."""
    center = PITCH_MM * np.array([hole % COLUMNS, hole // COLUMNS], np.float64)
    return hole_trial(RADII_MM[hole], center, CORNER_MM, seed)


def calibrate_work(work: HoleWork) -> dict[str, Any]:
    """Touch a flat wall in every direction that the searches use; from disk where it is there."""
    key = _key(work)
    known = _stored(work.path, key)
    if known is not None and _quiet_path(work).is_file():
        return known
    site = HoleSite(Grasp.of(work.seed), CALIBRATION_SEEDS + HOLE_SEEDS * work.seed)
    quiet = quiet_windows(site)
    save_windows(_quiet_path(work), quiet)
    detector = detector_for(site, work.detector, quiet)
    record: dict[str, Any] = {"key": key, "seed": work.seed}
    past = functools.partial(
        _inherit, site, detector, np.random.default_rng([work.seed, PAST_STREAM])
    )
    for style in STYLES:
        recording = RecordingProber(prober_for(site, detector, style), [work.seed, 4])
        touch_flat_walls(site, recording, style, work.cycles[style], past)
        record[style] = recording.kept
    write_json(work.path, record)
    return record


def touch_flat_walls(
    site: HoleSite,
    prober: Prober,
    style: str,
    cycles: int,
    past: Callable[[], None] | None = None,
) -> None:
    """Touch a flat wall at :data:`WALL_MM`, turned to each direction that a style uses.

    The travel depends a little on the direction before, so they follow each other as in use: in any
    order for the adaptive search, or in the cross's own, after ``past`` made an earlier contact.
    """
    for cycle in range(cycles):
        angles = np.radians(ANGLES_DEG[style])
        if style == DEFAULT:
            angles = np.random.default_rng(cycle).permutation(angles)
        elif past is not None:
            past()
        for angle in angles:
            direction = np.array([np.cos(angle), np.sin(angle)])
            site.set_wall(flat_wall(direction, WALL_MM), np.zeros(2))
            with contextlib.suppress(SearchError):  # a touch that failed teaches nothing
                prober.touch(np.zeros(2), direction)


def search_work(work: HoleWork) -> dict[str, Any]:
    """Search one hole both ways; from disk where it is there."""
    assert work.hole is not None
    key = _key(work)
    known = _stored(work.path, key)
    if known is not None:
        return known
    calibration = calibrate_work(replace(work, hole=None))
    trial = trial_of(work.seed, work.hole)
    site = HoleSite(Grasp.of(work.seed), HOLE_SEEDS * work.seed + work.hole)
    detector = detector_for(site, work.detector, load_windows(_quiet_path(work)))
    _inherit(site, detector, np.random.default_rng([work.seed, PAST_STREAM, work.hole]))
    record: dict[str, Any] = {"key": key, "seed": work.seed, "hole": work.hole}
    for style in STYLES:
        site.set_wall(trial.wall, trial.start_mm)
        prober = prober_for(site, detector, style)
        recording = RecordingProber(prober, [work.seed, 5, work.hole])
        travel = travel_of(calibration[style], PLANNING_MM)
        found: dict[str, Any] = {"used": [], "error": None}
        try:
            used = _touches_of(style, recording, trial.start_mm, travel)
            found["used"] = recording.numbers(used)
        except SearchError as failure:
            found["error"] = str(failure)
        record[style] = {"touches": recording.kept, **found}
        _let_go(site)
    write_json(work.path, record)
    return record


def _touches_of(
    style: str, prober: Prober, start_mm: Vector, travel: TravelModel
) -> Sequence[Touched]:
    if style == CROSS:
        return cross_search(prober, start_mm, travel)
    config = AdaptiveSearchConfig(contacts=MOST_CONTACTS)
    return AdaptiveSearch(prober, travel, config).run(start_mm).touches


def prober_for(site: HoleSite, detector: ContactDetector, style: str) -> ArmProber:
    """Return who touches in one of the :data:`STYLES`."""
    return ArmProber(
        site.rig.arm, site.windows(), detector, STYLES[style], free_travel=site.free_travel
    )


def detector_for(
    site: HoleSite, name: str, quiet: Sequence[tuple[EventPacket, ...]]
) -> ContactDetector:
    """Return a contact detector for the site's finger."""
    return make_detector(name, DetectionConfig(), [site.calibration], quiet)


def _inherit(site: HoleSite, detector: ContactDetector, rng: np.random.Generator) -> None:
    """Touch another wall and let a second pass: the contact whose traces the pixels inherit."""
    angle = 2.0 * np.pi * rng.uniform()
    direction = np.array([np.cos(angle), np.sin(angle)])
    site.set_wall(flat_wall(direction, WALL_MM), np.zeros(2))
    with contextlib.suppress(SearchError):
        prober_for(site, detector, DEFAULT).touch(np.zeros(2), direction)
    site.rig.wait(1.0)


def _let_go(site: HoleSite) -> None:
    """Wait until the arm rests and the rod hangs free, so that it can be put elsewhere."""
    while site.rig.arm.state() is ArmState.MOVING:
        site.rig.wait(0.01)


def quiet_windows(site: HoleSite, count: int = QUIET_WINDOWS) -> list[tuple[EventPacket, ...]]:
    """Return windows of the moving arm in free air."""
    here = site.rig.arm.true_position_mm()
    windows = site.windows()
    seconds = (count + 200) * 1e-3
    away_mm = np.array([QUIET_SPEED_MM_S * seconds, 0.0, 0.0])
    site.rig.arm.move_linear(here + away_mm, QUIET_SPEED_MM_S)
    for _ in range(100):
        next(windows)
    quiet = [next(windows) for _ in range(count)]
    while site.rig.arm.state() is ArmState.MOVING:
        next(windows)
    return quiet


def _quiet_path(work: HoleWork) -> Path:
    return work.folder / "touches" / f"seed-{work.seed}" / "quiet.npz"


def _key(work: HoleWork) -> str:
    return f"{code_digest(CODE)}-{work.detector}-{'quick' if work.quick else 'full'}"


def _stored(path: Path, key: str) -> dict[str, Any] | None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if record.get("key") == key else None
