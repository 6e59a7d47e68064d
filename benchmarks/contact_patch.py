"""How far the area and outline of a touch agree with the true contact: presses on the twin.

    python benchmarks/contact_patch.py

Prints the intersection over union of the outline, and of a disc of the touch's area at its place,
with the cells of the skin that the body touches. Simulated.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from spikingtac.config import load_config
from spikingtac.experiments.touch.true_calibration import true_calibration
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.sim.gel.indenters import IndenterConfig
from spikingtac.sim.scene.motions import MotionConfig
from spikingtac.sim.scene.scene import ContactConfig, Scene
from spikingtac.sim.scene.segments import SegmentConfig
from spikingtac.sim.scene.source import SceneSource
from spikingtac.touch.touches.detector import TouchDetector
from spikingtac.types import EventPacket

BODIES = (
    ("ball", {"radius_x_mm": 5.0, "radius_y_mm": 5.0}, 0.5),
    ("ball", {"radius_x_mm": 8.0, "radius_y_mm": 8.0}, 0.8),
    ("punch", {"radius_mm": 2.0}, 0.35),
    ("punch", {"radius_mm": 4.0}, 0.35),
    ("finger", {"radius_x_mm": 7.0, "radius_y_mm": 7.0}, 1.8),
)
"""Indenter, settings and depth, mm: contacts of 3.6 to 8.9 mm."""
SEEDS = (1, 2, 3)
PITCH_MM, MARKERS = 2.4, 8
"""The twin's grid."""
PLACE_MM = 2.5
"""Presses lie within this distance of the middle, per axis, mm."""


class Watched:
    """A press's events, with the touched cells kept on the way."""

    def __init__(self, body: tuple[str, dict[str, float], float], seed: int) -> None:
        """Build the scene."""
        kind, settings, depth_mm = body
        x, y = np.random.default_rng(seed).uniform(-PLACE_MM, PLACE_MM, 2).tolist()
        segments = (
            SegmentConfig(kind="press", depth_mm=depth_mm, duration_s=0.3),
            SegmentConfig(kind="hold", duration_s=0.3),
            SegmentConfig(kind="lift", height_mm=0.2, duration_s=0.2),
        )
        motion = MotionConfig(x_mm=x, y_mm=y, height_mm=0.2, segments=segments)
        contact = ContactConfig(
            indenter=IndenterConfig(kind=kind, settings=settings), motion=motion
        )
        scene = Scene(about="a press", lead_in_s=0.2, lead_out_s=0.3, contacts=(contact,))
        self.source = SceneSource(scene.with_camera("typical"), seed)
        self.size = self.source.size
        self.cells: list[tuple[int, NDArray[np.uint8]]] = []

    def __iter__(self) -> Iterator[EventPacket]:
        """Yield the events."""
        for step in self.source.steps():
            told = step.truth
            rows = zip(told.contact_t_us.tolist(), told.touching_cells, strict=True)
            self.cells += [(t_us, bits.copy()) for t_us, bits in rows]
            yield step.packet


def agreement(watched: Watched) -> tuple[float, float, float]:
    """Return the true diameter, mm, and the two intersections over union; nan without a touch."""
    source, config = watched.source, load_config("default").tracking
    detector = TouchDetector(source.reference_px)
    tracker = make_tracker(config, true_calibration(source))
    ended = [detector.update(frame) for frame in follow(watched, tracker, 1e3)]
    touches = [touch for touch in (*ended, detector.finish()) if touch is not None]
    if not touches:
        return np.nan, np.nan, np.nan
    touch, grid = touches[0], source.scene.gel.grid
    _, bits = min(watched.cells, key=lambda row: abs(row[0] - touch.peak_us))
    true = np.unpackbits(bits)[: grid.cells**2].astype(bool)
    places_px = _on_image(np.array(np.meshgrid(grid.axis_mm, grid.axis_mm)), source.reference_px)
    outline = np.zeros(len(true), bool)
    if len(touch.outline_px) > 2:
        outline = Outline(touch.outline_px).contains_points(places_px)
    far2 = ((places_px - touch.place_px) ** 2).sum(axis=1)
    disc = np.pi * far2 <= touch.area_px2
    diameter_mm = 2.0 * float(np.sqrt(true.sum() * grid.pitch_mm**2 / np.pi))
    return diameter_mm, _overlap(outline, true), _overlap(disc, true)


def _on_image(places_mm: NDArray[np.float64], reference_px: NDArray[np.float64]) -> np.ndarray:
    """Return places ``(2, n, n)`` of the skin in the image, ``(n * n, 2)``, by the markers."""
    axis = PITCH_MM * (np.arange(MARKERS) - 0.5 * (MARKERS - 1))
    markers = np.array(np.meshgrid(axis, axis)).reshape(2, -1)
    ones = np.ones((1, markers.shape[1]))
    map_px, *_ = np.linalg.lstsq(np.vstack([markers, ones]).T, reference_px, rcond=None)
    flat = places_mm.reshape(2, -1)
    return np.vstack([flat, np.ones((1, flat.shape[1]))]).T @ map_px


def _overlap(found: NDArray[np.bool_], true: NDArray[np.bool_]) -> float:
    return float((found & true).sum() / max((found | true).sum(), 1))


def main() -> None:
    """Press every body at every place and print a line for each."""
    rows = []
    for body in BODIES:
        for seed in SEEDS:
            rows.append(agreement(Watched(body, seed)))
            print("{} {}: {:.1f} mm, outline {:.2f}, disc {:.2f}".format(body[0], seed, *rows[-1]))
    print("median: outline {1:.2f}, disc {2:.2f}".format(*np.nanmedian(rows, axis=0)))


if __name__ == "__main__":
    main()
