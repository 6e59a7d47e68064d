"""The plan of a collision run: its approaches and its motions without contact."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from spikingtac_paper.collision.scene import CollisionScene

Group = Literal["paired", "series", "sensitivity", "curve"]

SLOW, FASTEST = "0.0008", "0.18"
SPEEDS = ("0.01", "0.02", "0.04", "0.06", "0.08", "0.1", "0.12", "0.14", "0.16", FASTEST)
"""Speeds of the case ``all``, m/s: the paper names the range 0.01 to 0.18."""
PRESETS = ("typical", "noisy")
ALL = "all"
BUDGETS_PER_HOUR = (1.0, 10.0, 100.0, 1_000.0, 10_000.0)
"""Budgets of false stops for the curve of delay against false stops."""
CURVE_SPEED = "0.01"
QUIET_SEED, STRETCH_SEED = 900_000, 500_000
"""First seeds of the quiet recordings and of the motions without contact. No approach uses them."""
STRETCH_STEPS = 100_000
"""Length of one motion without contact, ms."""
FORCED_MM, FRAMES_S = 4.0, 0.036
"""A run ends 4 mm or 36 ms after the touch, whichever is later: this is one frame at least. The
pads' linear fields are not valid beyond 8 mm."""
SERIES_MM = 0.8
"""Travel after the touch at which the long series at 0.8 mm/s ends, mm: twice the largest aim."""

VARIANTS: dict[str, dict[str, object]] = {
    "pinned": {},
    "stickout-20mm": {"stickout_mm": 20.0},
    "stickout-60mm": {"stickout_mm": 60.0},
    "contrast-4": {"contrast": 4.0},
    "contrast-8": {"contrast": 8.0},
    "threshold-0.18": {"threshold": 0.18},
    "threshold-0.35": {"threshold": 0.35},
    "load-axial": {"load": "axial"},
    "load-across": {"load": "across"},
    "past-rested": {"past": "rested"},
    "past-fresh": {"past": "fresh"},
}
"""Changes of the sensitivity study, one at a time."""
SENSITIVITY_SPEEDS = (SLOW, FASTEST)


@dataclass(frozen=True, kw_only=True, slots=True)
class CollisionConfig:
    """The size of a run.

    Attributes:
        first_seed: First seed of the approaches.
        serials: Number of sensor specimens; the seeds use them in turn, each with its calibration.
        seeds: Number of approaches at each speed.
        fastest: Number of approaches at 0.18 m/s.
        slow: Number of approaches at 0.8 mm/s that give every method all the time it needs.
        series: Number of further approaches at 0.8 mm/s on the first preset, for the methods that
            found all of the slow ones within half of :data:`SERIES_MM`.
        stretches: Number of motions without contact per preset, 100 s each: ten hours in all.
        sensitivity: Number of approaches per variant and speed.
        curve: Number of approaches for the curve of delay against false stops.
        curve_stretches: Number of motions without contact for this curve.
    """

    first_seed: int = 0
    serials: int = 4
    seeds: int = 20
    fastest: int = 200
    slow: int = 60
    series: int = 940
    stretches: int = 364
    sensitivity: int = 8
    curve: int = 20
    curve_stretches: int = 72

    @classmethod
    def quick(cls, first_seed: int = 0) -> CollisionConfig:
        """Return the size of a run of some minutes, with every method, case and metric."""
        return cls(
            first_seed=first_seed,
            serials=1,
            seeds=1,
            fastest=4,
            slow=2,
            series=0,
            stretches=8,
            sensitivity=1,
            curve=2,
            curve_stretches=2,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class ApproachTask:
    """One approach.

    Attributes:
        scene: The scene.
        speed: Speed in m/s, as in the report's cases.
        seed: Seed of everything random.
        group: The part of the experiment that uses it.
        case: Case of the report.
        patience_mm: Travel of the arm after the touch at which the run ends, mm.
    """

    scene: CollisionScene
    speed: str
    seed: int
    group: Group
    case: str
    patience_mm: float

    @property
    def speed_mm_s(self) -> float:
        """Speed of the arm, mm/s."""
        return 1000.0 * float(self.speed)


@dataclass(frozen=True, kw_only=True, slots=True)
class FreeMotionTask:
    """One motion without contact.

    Attributes:
        scene: The scene; its wall is not used.
        seed: Seed of everything random.
        steps: Length, ms.
        group: The part of the experiment that uses it.
        case: Case of the report.
    """

    scene: CollisionScene
    seed: int
    group: Group
    case: str
    steps: int = STRETCH_STEPS


@dataclass(frozen=True, kw_only=True, slots=True)
class Plan:
    """The tasks of a run; the series is planned after the results of the others."""

    approaches: tuple[ApproachTask, ...] = ()
    stretches: tuple[FreeMotionTask, ...] = field(default=())

    @property
    def scenes(self) -> list[CollisionScene]:
        """The scenes that need a quiet recording, each once."""
        return list(dict.fromkeys(one.scene for one in (*self.approaches, *self.stretches)))


def pinned_scene(config: CollisionConfig, preset: str, seed: int) -> CollisionScene:
    """Return the scene of contract.md with the sensor specimen of a seed."""
    return CollisionScene(preset=preset, serial=1 + seed % config.serials)


def plan(config: CollisionConfig) -> Plan:
    """Return the tasks of a run, the longest first, so that no process waits for one at the end."""
    slow = [one for preset in PRESETS for one in _approaches(config, preset, SLOW, config.slow)]
    rest = [
        one
        for preset in PRESETS
        for speed in SPEEDS
        for one in _approaches(
            config, preset, speed, config.fastest if speed == FASTEST else config.seeds
        )
    ]
    varied = [*_sensitivity(config), *_curve(config)]
    stretches = [
        *(one for preset in reversed(PRESETS) for one in _stretches(config, preset, "paired")),
        *_stretches(config, PRESETS[0], "curve"),
    ]
    return Plan(approaches=(*slow, *rest, *varied), stretches=tuple(stretches))


def series(config: CollisionConfig) -> Plan:
    """Return the long series at 0.8 mm/s."""
    first = config.first_seed + config.slow
    return Plan(
        approaches=tuple(
            ApproachTask(
                scene=pinned_scene(config, PRESETS[0], seed),
                speed=SLOW,
                seed=seed,
                group="series",
                case=f"{PRESETS[0]}/{SLOW}",
                patience_mm=SERIES_MM,
            )
            for seed in range(first, first + config.series)
        )
    )


def patience_mm(speed: str) -> float:
    """Return the travel after the touch that leaves every method the time it needs, mm."""
    return max(FORCED_MM, 1000.0 * float(speed) * FRAMES_S)


def _approaches(config: CollisionConfig, preset: str, speed: str, count: int) -> list[ApproachTask]:
    return [
        ApproachTask(
            scene=pinned_scene(config, preset, seed),
            speed=speed,
            seed=seed,
            group="paired",
            case=f"{preset}/{speed}",
            patience_mm=patience_mm(speed),
        )
        for seed in range(config.first_seed, config.first_seed + count)
    ]


def _sensitivity(config: CollisionConfig) -> list[ApproachTask]:
    return [
        ApproachTask(
            scene=replace(CollisionScene(), **changes),  # type: ignore[arg-type]
            speed=speed,
            seed=config.first_seed + number,
            group="sensitivity",
            case=f"{name}/{speed}",
            patience_mm=FORCED_MM / 2.0,
        )
        for name, changes in VARIANTS.items()
        for speed in SENSITIVITY_SPEEDS
        for number in range(config.sensitivity)
    ]


def _curve(config: CollisionConfig) -> list[ApproachTask]:
    return [
        ApproachTask(
            scene=pinned_scene(config, PRESETS[0], 0),
            speed=CURVE_SPEED,
            seed=config.first_seed + number,
            group="curve",
            case=f"budget/{CURVE_SPEED}",
            patience_mm=FORCED_MM,
        )
        for number in range(config.curve)
    ]


def _stretches(config: CollisionConfig, preset: str, group: Group) -> list[FreeMotionTask]:
    count = config.curve_stretches if group == "curve" else config.stretches
    first = STRETCH_SEED + 1_000 * config.first_seed
    return [
        FreeMotionTask(
            scene=pinned_scene(config, preset, 0 if group == "curve" else number),
            seed=first + number,
            group=group,
            case="budget" if group == "curve" else f"{preset}/{ALL}",
        )
        for number in range(count)
    ]
