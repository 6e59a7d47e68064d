"""What is seen of the skin: the tracker's measured errors, or the event camera and the tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import spikingtac as st
from spikingtac.sim import Optics, SensingFinger, SkinConfig, SkinState, image_radius_px
from spikingtac_mujoco.pad import Mount

Floats = NDArray[np.float64]

# Displacements ``(m, 2)`` as they are told, px; ``(m,)`` predicted markers; the true ones, px.
Seen = tuple[Floats, NDArray[np.bool_], Floats]

DELAY_US = 250.0  # Delay of the tracker behind the motion, us (measured, results/mujoco).

# Standard deviation of a marker's error, px a coordinate (measured), and the path over which it
# is renewed, px: pixels are silent where nothing moves, so that the error moves with the marker.
NOISE_PX, NOISE_PATH_PX = 0.10, 1.0
REST_PX = 0.002  # Standard deviation of the error that is renewed at each look, px (measured).

# Share of the markers that are predicted at a time (none in 150,000 looks: at most 3 over that
# number with 95 % confidence).
LOST_SHARE = 2e-5

# Period of the tracker's estimates, us: with 10 ms its error would be twice as large.
ESTIMATE_US = 1_000


def at_rest(mount: Mount) -> SkinState:
    """Return the skin that nothing touches."""
    rest_mm = mount.rest_mm
    return replace(
        SkinConfig().at_rest(),
        marker_mm=np.column_stack((rest_mm, np.zeros(len(rest_mm)))),
        gradient=np.tile(np.eye(2), (len(rest_mm), 1, 1)),
    )


class MarkerObserver:
    """True displacements, later and with errors as measured on :class:`EventObserver`.

    Args:
        mount: The sensor.
        optics: Its lens.
        seed: Seed of the errors.
        ideal: Without errors and delay.
    """

    def __init__(self, mount: Mount, optics: Optics, seed: int, ideal: bool = False) -> None:
        self._optics, self._ideal = optics, ideal
        self._rng = np.random.default_rng(seed)
        self._reference = optics.project(at_rest(mount)).center_px
        self._error = np.zeros(self._reference.shape)

    def begin(self, state: SkinState) -> Seen:
        """Take the skin at the start."""
        self._t_us = state.t_us - 1
        self._last = self._optics.project(state).center_px - self._reference
        return self.observe(state)

    def observe(self, state: SkinState) -> Seen:
        """Take the skin at a later time."""
        true = self._optics.project(state).center_px - self._reference
        step, span_us = true - self._last, state.t_us - self._t_us
        self._t_us, self._last = state.t_us, true
        if self._ideal:
            return true, np.zeros(len(true), bool), true
        keep = np.exp(-np.linalg.norm(step, axis=1, keepdims=True) / NOISE_PATH_PX)
        fresh, jitter = self._rng.standard_normal((2, *true.shape))
        self._error = keep * self._error + NOISE_PX * np.sqrt(1.0 - keep**2) * fresh
        late = true - min(DELAY_US / span_us, 1.0) * step
        lost = self._rng.random(len(true)) < LOST_SHARE
        return late + self._error + REST_PX * jitter, lost, true


class EventObserver:
    """The twin's event camera looks at the skin, and the product's tracker follows its markers.

    Args:
        mount: The sensor.
        optics: Its lens.
        seed: Seed of the camera's noise.

    Attributes:
        packet: Events since the last look.
    """

    PRESET = "fast"  # Preset of the tracker.

    def __init__(self, mount: Mount, optics: Optics, seed: int) -> None:
        self._finger, self._mount = SensingFinger(mount.camera, seed, optics=mount.optics), mount
        self._reference = self._finger.optics.project(at_rest(mount)).center_px
        self.packet: st.EventPacket | None = None

    def begin(self, state: SkinState) -> Seen:
        """Take the skin at the start: the tracker is calibrated where the markers stand then."""
        image = self._finger.optics.project(state)
        self._finger.camera.settle(image)
        calibration = st.Calibration(
            reference_px=image.center_px,
            radius_px=image_radius_px(image),
            grid=self._mount.grid,
            size=self._mount.optics.size,
        )
        self._tracker = st.make_tracker(st.load_config(self.PRESET).tracking, calibration)
        self._before = image.center_px - self._reference
        return self._before, np.zeros(len(self._before), bool), self._before

    def observe(self, state: SkinState) -> Seen:
        """Take the skin at a later time."""
        image = self._finger.optics.project(state)
        rest = self.packet = self._finger.camera.advance([image])
        for t_us in range(rest.t_start_us + ESTIMATE_US, state.t_us, ESTIMATE_US):
            part, rest = rest.split(t_us)
            self._tracker.absorb(part)
            self._tracker.estimate(t_us)
        self._tracker.absorb(rest)
        frame, true = self._tracker.estimate(state.t_us), image.center_px - self._reference
        return self._before + frame.displacement_px, frame.coasted, true
