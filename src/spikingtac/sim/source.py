"""A scene as a stream of packets with ground truth: gel, optics and camera advance together."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from spikingtac.errors import require_type
from spikingtac.sim.camera.event_camera import EventCamera
from spikingtac.sim.gel import Gel
from spikingtac.sim.optics import MarkerImage, Optics, SkinState, image_radius_px
from spikingtac.sim.scene import LOADED, Scene
from spikingtac.sim.timeline import DRAG_S, Timeline, prior_drag_mm
from spikingtac.types import EventPacket, FloatArray, LossCounters

T = TypeVar("T")


def prefetch(items: Iterable[T], depth: int) -> Generator[T, None, None]:
    """Yield the items in order while a thread prepares up to ``depth`` of them.

    An exception of the producer is raised here at the place of the item. The thread ends with the
    iteration, also if the caller ends it early.

    Args:
        items: Items to prepare.
        depth: Number of items that are prepared.
    """
    source, end = iter(items), object()
    worker = ThreadPoolExecutor(1, "spikingtac-prefetch")
    ready = deque(worker.submit(next, source, end) for _ in range(depth))
    try:
        while (item := ready.popleft().result()) is not end:
            ready.append(worker.submit(next, source, end))
            yield cast(T, item)
    finally:
        worker.shutdown(cancel_futures=True)


# Longest time between two rows of the truth, us. The camera interpolates the images linearly
# between the gel's steps. Rows fall on those steps and between them, so that linear interpolation
# of the truth is exact.
ROW_US = 1000

# Every scene of the package touches within its first second; coarse steps will do.
TOUCHED_S, TOUCH_STEP_S = 1.0, 0.02


def touch_once(scene: Scene, seed: int) -> None:
    """Simulate a scene's first contact with the gel, so that the gel's kernels are in the cache."""
    gel, timeline = Gel(scene.gel, scene.skin.rest_mm()), Timeline(scene, seed)
    for step in range(round(TOUCHED_S / TOUCH_STEP_S)):
        gel.step(TOUCH_STEP_S, *(timeline.at(step * TOUCH_STEP_S) or (None, None)))


MECHANICS_HZ = 250.0  # Lowest rate of the gel's steps unless another is asked for, Hz.

# Steps of the gel that a thread prepares while the camera renders (0.26 s at 250 Hz).
PREFETCH_STEPS = 64


# Largest motion of a body in one step of the gel, mm: 50 mm/s at 250 Hz. A sudden release is faster
# and gets shorter steps.
STEP_MM = 0.2

# Largest number of steps in one period: 0.5 ms at 250 Hz. A shear wave crosses the gel in about
# that time, and no skin moves back faster.
STEPS_PER_PERIOD = 8


class TruthChunk(NamedTuple):
    """Ground truth over a stretch of time.

    Attributes:
        marker_t_us: ``(n,)`` times of the markers' rows, us.
        marker_px: ``(n, m, 2)`` optical centres of the undamaged discs, px.
        contact_t_us: ``(k,)`` times of the rows below, one for each step of the gel, us.
        force_n: ``(k, 3)`` force of the indenter on the skin, N.
        torque_n_mm: ``(k, 3)`` its moment about the optical axis and the skin at rest, N mm.
        touching_cells: ``(k, ceil(n² / 8))`` the cells of the skin that are touched, one bit each
            (:class:`~spikingtac.sim.optics.SkinState`).
        sticking_cells: ``(k, ceil(n² / 8))`` those that are touched and do not slip.
        pose_mm: ``(k, 3)`` the indenter's reference point, mm (x right, y down, z depth).
        in_contact: ``(k,)`` True where any pressure acts.
    """

    marker_t_us: NDArray[np.int64]
    marker_px: NDArray[np.float32]
    contact_t_us: NDArray[np.int64]
    force_n: FloatArray
    torque_n_mm: FloatArray
    touching_cells: NDArray[np.uint8]
    sticking_cells: NDArray[np.uint8]
    pose_mm: FloatArray
    in_contact: NDArray[np.bool_]

    @classmethod
    def of_step(cls, state: SkinState, now: MarkerImage, then: MarkerImage) -> TruthChunk:
        """Return the truth of one step of the gel, without the first instant of the next step."""
        rows = max(1, -(-(then.t_us - now.t_us) // ROW_US))
        fraction = np.arange(rows)[:, None, None] / rows
        moved = then.center_px - now.center_px
        return cls(
            marker_t_us=now.t_us + (then.t_us - now.t_us) * np.arange(rows, dtype=np.int64) // rows,
            marker_px=(now.center_px + fraction * moved).astype(np.float32),
            contact_t_us=np.array([now.t_us], np.int64),
            force_n=np.array(state.force_n, np.float64)[None],
            torque_n_mm=np.array(state.torque_n_mm, np.float64)[None],
            touching_cells=state.touching_cells[None],
            sticking_cells=state.sticking_cells[None],
            pose_mm=np.array(state.pose_mm, np.float64)[None],
            in_contact=np.array([state.in_contact]),
        )


class SceneStep(NamedTuple):
    """One step of a scene.

    Attributes:
        packet: Events of the step.
        truth: Ground truth over the same span.
    """

    packet: EventPacket
    truth: TruthChunk


class SceneSource:
    """A simulated sensor: an :class:`~spikingtac.events.source.EventSource` with ground truth.

    Memory does not grow with the length of the scene. The source can be iterated once: a new
    iteration continues where the last one ended.

    Args:
        scene: The scene.
        seed: Seed of the variations and of the camera's noise. Equal seeds give equal events.
        duration_s: Length, s. None is the scene's own length; a shorter one cuts the scene, a
            longer one repeats its contacts; ``math.inf`` never ends.
        mechanics_hz: Lowest rate of the gel's steps, Hz. The camera interpolates between them.

    Attributes:
        size: ``(width, height)`` of the sensor, px.
        losses: Number of events that the readout has lost, by kind.
        t_end_us: End of the stream, us, or None.
        reference_mm: ``(m, 2)`` nominal places of the markers at rest, mm.
        cell_axis_mm: ``(n,)`` centres of the skin's cells along x and along y, mm.
        reference_px: ``(m, 2)`` markers at rest, px.
        radius_px: ``(m,)`` radii on the image at rest, px.

    Raises:
        ConfigError: No scene is given, but something else, as a scene's name.

    Example:
        >>> from spikingtac.sim import catalog
        >>> source = SceneSource(catalog.load_scene("quiet"), seed=1, duration_s=0.01)
        >>> [packet.t_end_us for packet in source]
        [4000, 8000, 12000]
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        duration_s: float | None = None,
        mechanics_hz: float = MECHANICS_HZ,
    ) -> None:
        require_type(scene, Scene, LOADED)
        self.scene, self.seed = scene, seed
        self.size = scene.size
        self._timeline = Timeline(scene, seed, duration_s)
        self._period_us = round(1e6 / mechanics_hz)
        end_s = self._timeline.duration_s
        self.t_end_us: int | None = None
        if not math.isinf(end_s):
            self.t_end_us = math.ceil(round(end_s * 1e6) / self._period_us) * self._period_us
        self._gel = Gel(scene.gel, scene.skin.rest_mm())
        self._optics = Optics(scene.optics, seed=scene.skin.serial)
        camera = scene.camera.resolve()
        self._camera = EventCamera(camera, scene.size, seed, serial=scene.skin.serial)
        rest = self._optics.project(scene.skin.at_rest())
        self.reference_mm: FloatArray = scene.skin.rest_mm()
        self.cell_axis_mm: FloatArray = scene.gel.grid.axis_mm
        self.reference_px: FloatArray = rest.center_px
        self.radius_px: FloatArray = image_radius_px(rest)
        self.losses: LossCounters = self._camera.losses
        self._steps = self._run()

    def __iter__(self) -> Iterator[EventPacket]:
        for step in self._steps:
            yield step.packet

    def manifest(self) -> dict[str, Any]:
        """Return what a manifest says of a simulation; it holds neither date nor machine."""
        camera = self.scene.camera.resolve()
        return {
            "source": "twin",
            "grid": list(self.scene.skin.grid),
            "seed": self.seed,
            "contrast": camera.light.contrast,
            "threshold_on": camera.pixel.threshold_on,
            "threshold_off": camera.pixel.threshold_off,
            "scene_sha256": self.scene.digest(),
        }

    def steps(self) -> Generator[SceneStep, None, None]:
        """Yield the packets together with the truth over their spans."""
        return self._steps

    def _run(self) -> Generator[SceneStep, None, None]:
        frames = prefetch(self.frames(), PREFETCH_STEPS)
        state, image = next(frames)
        with contextlib.closing(frames):
            self._precondition()
            for next_state, next_image in frames:
                packet = self._camera.advance([next_image])
                yield SceneStep(packet, TruthChunk.of_step(state, image, next_image))
                state, image = next_state, next_image

    def _precondition(self) -> None:
        """Show the camera the history before the recording, up to time zero."""
        history, rest = self.scene.history, self.scene.skin.at_rest()
        span_us = round(1e6 * (history.wait_s + DRAG_S))
        before_us = np.arange(span_us, -1, -self._period_us, dtype=np.int64)
        times_us = np.append(-before_us[before_us > 0], 0)
        drag_mm = prior_drag_mm(history, self.seed, (times_us - times_us[0]) * 1e-6)
        places_mm = rest.marker_mm + np.pad(drag_mm, ((0, 0), (0, 1)))[:, None]
        states = (
            replace(rest, t_us=int(t_us), marker_mm=marker_mm)
            for t_us, marker_mm in zip(times_us, places_mm, strict=True)
        )
        self._camera.settle(self._optics.project(next(states)), history.references)
        for state in states:
            self._camera.advance([self._optics.project(state)])

    def frames(self) -> Iterator[tuple[SkinState, MarkerImage]]:
        """Yield skin and image at each step of the gel, from time zero, without the camera."""
        none = np.packbits(self._gel.pressure_mpa > 0.0)
        state = replace(self.scene.skin.at_rest(), touching_cells=none, sticking_cells=none)
        yield state, self._optics.project(state)
        for start_us in itertools.count(0, self._period_us):
            if start_us == self.t_end_us:
                return
            # Several steps in a period where the body moves fast.
            end_us = start_us + self._period_us
            moved_mm = self._timeline.moved_mm(start_us * 1e-6, end_us * 1e-6)
            steps = min(math.ceil(moved_mm / STEP_MM), STEPS_PER_PERIOD) or 1
            before_us = start_us
            for number in range(1, steps + 1):
                t_us = start_us + self._period_us * number // steps
                body = self._timeline.at(t_us * 1e-6) or (None, None)
                state = self._gel.step((t_us - before_us) * 1e-6, *body)
                before_us = t_us
                yield state, self._optics.project(state)
