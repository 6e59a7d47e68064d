"""A prober without dynamics: a hexagonal bit in a round hole, exact geometry, friction, noise."""

from dataclasses import dataclass, field

import numpy as np

from spikingtac.errors import SearchError
from spikingtac.robot.prober import Touched
from spikingtac.sim.rig.walls import Bit

BISECTIONS = 36  # 11 mm to less than a nanometre.


@dataclass
class IdealProber:
    """Meets the wall where the corners do, and decides after a travel; slides beyond the cone."""

    radius_mm: float
    center_mm: tuple[float, float] = (0.0, 0.0)
    heading_rad: float = 0.3
    travel_mm: float = 0.12
    friction: float = 0.3
    reach_mm: float = 11.0
    noise_mm: list[float] = field(default_factory=list)
    starts: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.corner_mm = Bit(heading_rad=self.heading_rad).points_mm[:, :2]

    def place_mm(self) -> np.ndarray:
        return np.array(self.center_mm)

    def gap_mm(self, at_mm: np.ndarray) -> float:
        away = at_mm + self.corner_mm - np.array(self.center_mm)
        return self.radius_mm - float(np.linalg.norm(away, axis=1).max())

    def touch(self, start_mm: np.ndarray, direction: np.ndarray) -> Touched:
        self.starts.append(np.array(start_mm))
        low, high = 0.0, self.reach_mm
        if self.gap_mm(start_mm + high * direction) > 0.0:
            raise SearchError("no wall within reach")
        for _ in range(BISECTIONS):
            middle = (low + high) / 2.0
            inside = self.gap_mm(start_mm + middle * direction) > 0.0
            low, high = (middle, high) if inside else (low, middle)
        met = start_mm + low * direction
        outward = (met - np.array(self.center_mm)) / np.linalg.norm(met - np.array(self.center_mm))
        cosine = float(outward @ direction)
        travel = self.travel_mm * max(1.0 / np.hypot(1.0, self.friction) / cosine, 1.0)
        noise = self.noise_mm.pop(0) if self.noise_mm else 0.0
        return Touched(np.array(start_mm), direction, met + (travel + noise) * direction)
