"""Contact patches on the twin, from events: presses of bodies at places that were not learned."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spikingtac.sim import ContactConfig, MotionConfig, Scene, SceneSource, SegmentConfig
from spikingtac.touch import Touch, TouchDetector
from spikingtac.types import FloatArray
from spikingtac_paper.harness.report import Metric
from spikingtac_paper.touch.contacts import LONG, TESTED, record, watch

PRESSES, QUICK_PRESSES = 120, 12
BODIES = (*TESTED, *LONG)
CAMERAS = ("typical", "noisy")  # Cameras, in turns.

# Seed of the first press, and how many further on those of the next seed begin.
FIRST_SEED, SEED_STRIDE = 900_000, 1_000
PLACE_MM = 4.0  # Presses lie within this distance of the middle, per axis, mm.
WIDE_MM = 3.0  # Narrower diameter from which a patch is asked to be right, mm.
ASKED = 0.7

METHODS = {
    "patch-model": "the touched cells of the skin, from the motion of the markers around them"
}
METRICS = (
    Metric("missed_presses", "presses", "presses that no touch was found for", "sum"),
    Metric("overlap", "1", "intersection over union of the outline and the touched cells"),
    Metric("overlap_asked", "1", f"share of the patches whose overlap is at least {ASKED}"),
    Metric("area_ratio", "1", "area that was told over the true one"),
    Metric("place_mm", "mm", "distance of the place from the middle of the touched cells"),
)


@dataclass(frozen=True, slots=True)
class WatchedPress:
    """A press as camera and tracker see it.

    Attributes:
        touch: The touch that was found; None where there was none.
        cells_px: ``(n, 2)`` where the twin's cells lie in the image, px.
        touched: ``(n,)`` which of them the body touches at that peak.
        cell_px2: ``(n,)`` area of each cell, px squared.
        px_per_mm: Scale of the image.
    """

    touch: Touch | None
    cells_px: FloatArray
    touched: NDArray[np.bool_]
    cell_px2: FloatArray
    px_per_mm: float

    @property
    def width_mm(self) -> float:
        """The narrower diameter of the true patch, that of an ellipse of its moments, mm."""
        if self.touched.sum() < 3:
            return 0.0
        spread = np.linalg.eigvalsh(np.cov(self.cells_px[self.touched].T))
        return 4.0 * float(np.sqrt(max(spread[0], 0.0))) / self.px_per_mm


def patch_records(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
    """Return the scores of every method on every press."""
    records = []
    for number in range(QUICK_PRESSES if quick else PRESSES):
        own = FIRST_SEED + seed * SEED_STRIDE + number
        body, scene = draw_press(np.random.default_rng(own))
        camera = CAMERAS[number % len(CAMERAS)]
        press = watch_press(scene, camera, own)
        size = "narrow" if press.width_mm < WIDE_MM else "all"
        cases = [f"patch/{size}-{body}", f"patch/{size}"]
        cases += [f"patch/{camera}"] * (size == "all")
        records += [record(method, cases, seed, patch_scores(press)) for method in methods]
    return records


def draw_press(rng: np.random.Generator) -> tuple[str, Scene]:
    """Return the name of a random body and a press of it."""
    body = BODIES[int(rng.integers(len(BODIES)))]
    x_mm, y_mm = rng.uniform(-PLACE_MM, PLACE_MM, 2).tolist()
    segments = (
        SegmentConfig(kind="press", depth_mm=float(rng.uniform(*body.depth_mm)), duration_s=0.3),
        SegmentConfig(kind="hold", duration_s=0.2),
        SegmentConfig(kind="lift", height_mm=0.2, duration_s=0.2),
    )
    yaw = body.yaw_deg(rng)
    motion = MotionConfig(x_mm=x_mm, y_mm=y_mm, yaw_deg=yaw, height_mm=0.2, segments=segments)
    contact = ContactConfig(indenter=body.indenter(rng), motion=motion)
    about = f"a press of a {body.name}"
    return body.name, Scene(about=about, lead_in_s=0.15, lead_out_s=0.2, contacts=(contact,))


def watch_press(scene: Scene, camera: str, seed: int) -> WatchedPress:
    """Return a press seen by a camera and the tracker ``default``."""
    source = SceneSource(scene.with_camera(camera), seed)
    cells: list[tuple[int, NDArray[np.uint8]]] = []

    def note(step: Any) -> None:
        told = step.truth
        cells.extend(zip(told.contact_t_us.tolist(), told.touching_cells.copy(), strict=True))

    detector = TouchDetector(source.reference_px)
    touches = [detector.update(frame) for frame in watch(source, note)]
    touch = next((one for one in (*touches, detector.finish()) if one is not None), None)
    peak_us = 0 if touch is None else touch.peak_us
    _, bits = min(cells, key=lambda row: abs(row[0] - peak_us))
    cells_px, cell_px2 = _cells_px(source)
    touched = np.unpackbits(bits)[: len(cells_px)].astype(np.bool_)
    return WatchedPress(touch, cells_px, touched, cell_px2, scene.optics.px_per_mm)


def _cells_px(source: SceneSource) -> tuple[FloatArray, FloatArray]:
    """Return where the cells of the skin lie in the image ``(n, 2)``, px, and their areas, px2.

    A cubic polynomial through the resting markers follows the lens to a hundredth of a pixel.
    """
    grid, rest_mm = source.scene.gel.grid, source.scene.skin.rest_mm()
    map_px, *_ = np.linalg.lstsq(_cubic(rest_mm), source.reference_px, rcond=None)
    places_mm = np.stack(np.meshgrid(grid.axis_mm, grid.axis_mm), axis=-1)
    cells_px = _cubic(places_mm.reshape(-1, 2)) @ map_px
    square: FloatArray = cells_px.reshape(grid.cells, grid.cells, 2)
    (xx, xy), (yx, yy) = (np.gradient(square[..., axis]) for axis in (0, 1))
    return cells_px, np.abs(xy * yx - yy * xx).ravel()


def _cubic(places: FloatArray) -> FloatArray:
    x, y = places.T
    return np.column_stack([x**i * y**j for i in range(4) for j in range(4 - i)])


def patch_scores(press: WatchedPress) -> dict[str, float]:
    """Return the scores of the patch that was told of a press."""
    # A late import: every verb's start would wait for it.
    from matplotlib.path import Path as Outline

    if press.touch is None or not press.touched.any():
        return {"missed_presses": 1.0}
    told, true = press.touch, press.touched
    found = Outline(told.outline_px).contains_points(press.cells_px)
    overlap = float((found & true).sum() / (found | true).sum())
    middle = press.cells_px[true].mean(axis=0)
    return {
        "missed_presses": 0.0,
        "overlap": overlap,
        "overlap_asked": float(overlap >= ASKED),
        "area_ratio": told.area_px2 / float(press.cell_px2[true].sum()),
        "place_mm": float(np.hypot(*(told.place_px - middle))) / press.px_per_mm,
    }
