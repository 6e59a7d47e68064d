"""What the tasks share: time, observation, seeds, pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

import spikingtac as st
from spikingtac_mujoco.draw import Camera, skin_image
from spikingtac_mujoco.pad import FRICTION, Mount, add_sensor, load_spec
from spikingtac_mujoco.sensor import Fidelity, Sensor

Floats = NDArray[np.float64]
Sense = Literal["markers", "events", "ideal", "blind"]
Observation = dict[str, NDArray[np.float32]]

# Step of the physics, s, and how many of them a step of the task has: 10 ms.
PHYSICS_S, SUBSTEPS = 0.001, 10
STEP_S = PHYSICS_S * SUBSTEPS
# Bounds of the observation; what is beyond is clipped.
LARGEST_PX, LARGEST = 100.0, 10.0
LARGEST_SEED = 1 << 31
# Reward, whether it is over, ``info``.
Outcome = tuple[float, bool, dict[str, Any]]


class TouchTask(gymnasium.Env[Observation, Floats]):
    """A robot with one sensor; see the classes of the tasks (all simulated).

    The observation is a dictionary: ``touch (m, 2)``, displacements of the markers, px, and
    ``state``, what the robot knows of itself. Actions are in [-1, 1].

    Args:
        sense: ``markers`` (displacements with the tracker's measured errors), ``events`` (the
            twin's event camera and the tracker), ``ideal`` (true displacements) or ``blind``
            (``touch`` is zero).
        render_mode: ``rgb_array`` or None.

    Raises:
        ConfigError: ``sense`` or ``render_mode`` is unknown.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 100}
    MODEL: ClassVar[str]
    STATES: ClassVar[int]
    ACTIONS: ClassVar[int] = 1
    STEPS: ClassVar[int]
    SKIN: ClassVar[float] = FRICTION

    def __init__(self, sense: Sense = "markers", render_mode: str | None = None) -> None:
        if sense not in get_args(Sense) or render_mode not in (None, "rgb_array"):
            raise st.ConfigError(f"{sense=}, {render_mode=}; valid: {get_args(Sense)}, 'rgb_array'")
        self.render_mode, self.sense = render_mode, sense
        spec = load_spec(Path(__file__).with_name(self.MODEL))
        mount = add_sensor(spec, site="fingertip", friction=self.SKIN)
        followers = self._extend(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        fidelity: Fidelity = "ideal" if sense == "blind" else sense
        self.sensor = Sensor(self.model, mount, fidelity, followers)
        shape = self.sensor.reference_px.shape
        self.observation_space = spaces.Dict(
            touch=spaces.Box(-LARGEST_PX, LARGEST_PX, shape, np.float32),
            state=spaces.Box(-LARGEST, LARGEST, (self.STATES,), np.float32),
        )
        self.action_space = spaces.Box(-1.0, 1.0, (self.ACTIONS,), np.float32)
        self._camera: Camera | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a new episode; equal seeds give equal episodes."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self._steps = 0
        info = self._begin(self.np_random)
        mujoco.mj_forward(self.model, self.data)
        self.reading = self.sensor.reset(self.data, int(self.np_random.integers(LARGEST_SEED)))
        self.observation = self._observation()
        return self.observation, info

    def step(self, action: Floats) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act for 10 ms."""
        wanted = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        for _ in range(SUBSTEPS):
            self._act(wanted)
            mujoco.mj_step(self.model, self.data)
            self._watch()
        self._steps += 1
        self.reading = self.sensor.step(self.data)
        reward, over, info = self._judge()
        info["time_s"] = self._steps * STEP_S
        late = self._steps >= self.STEPS
        self.observation = self._observation()
        return self.observation, float(reward), over, late and not over, info

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """Return robot and skin side by side."""
        if self.render_mode is None:
            return None
        self._camera = self._camera or Camera(self.model)
        force = self.reading.skin.force_n
        lines = [
            f"simulated, {self.data.time:4.2f} s",
            f"{np.hypot(*force[:2]):.2f} N across, {force[2]:.2f} N down",
            *self._lines(),
        ]
        skin = skin_image(self.sensor.reference_px, self.reading, lines)
        return np.hstack([self._camera.image(self.data), skin])

    def close(self) -> None:
        """Free the renderer."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _observation(self) -> Observation:
        touch = self.reading.displacement_px * (self.sense != "blind")
        return {
            "touch": np.clip(touch, -LARGEST_PX, LARGEST_PX).astype(np.float32),
            "state": np.clip(self._state(), -LARGEST, LARGEST).astype(np.float32),
        }

    def _extend(self, spec: mujoco.MjSpec) -> Sequence[Mount]:
        """Add what belongs to the sensor, and return other pads that carry the same load."""
        return ()

    def _watch(self) -> None:
        """Look at the physics after each of its steps."""

    def _begin(self, rng: np.random.Generator) -> dict[str, Any]:
        """Draw what is random, and return what is true of the episode."""
        raise NotImplementedError

    def _act(self, action: Floats) -> None:
        """Set the actuators for one step of the physics."""
        raise NotImplementedError

    def _judge(self) -> Outcome:
        """Return what the step led to."""
        raise NotImplementedError

    def _state(self) -> Floats:
        """Return what the robot knows of itself."""
        raise NotImplementedError

    def _lines(self) -> list[str]:
        """Return what is written below the skin besides time and force."""
        raise NotImplementedError
