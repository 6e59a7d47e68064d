"""The simulated sensor at run time: what touches the pad, the gel under it, and what is seen of it.

The pad's plate rests on springs. A body that presses moves the plate, and how far it stands below
the undeformed skin is the indentation. The twin's gel turns it into pressure, shear, slip and
creep; the plate's springs follow its stiffness and force, so that MuJoCo's contact force and the
gel's agree to 2 % once nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

import spikingtac as st
from spikingtac.sim import Gel, GelConfig, GridConfig, Optics, SkinConfig, SkinState
from spikingtac_mujoco.observers import EventObserver, MarkerObserver
from spikingtac_mujoco.pad import AXES, Mount
from spikingtac_mujoco.shapes import MM_PER_M, BodyIndenter

Floats = NDArray[np.float64]
Fidelity = Literal["markers", "events", "ideal"]

# Cells of the gel along a side: half of the twin's, where speed counts.
CELLS: dict[str, int] = {"markers": 32, "events": 64, "ideal": 32}

# Least and largest stiffness of the springs, N/m: below that of the lightest touch, and above
# that of a pad that is touched all over (measured on the gel: 115,000).
STIFFNESS_N_M = (300.0, 150_000.0)

# Lateral over normal stiffness (0.2 to 0.4 on the twin: too stiff follows, too soft
# swings).
SHEAR_SHARE = 0.5

# Joints along which the skin has no zero of its own: a cell sticks where it was first touched.
SIDEWAYS = np.array([True, True, False, False, False, True])

# The wrench on a pad that faces this one, turned by half a turn about the site's y axis.
MIRROR = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0])

# Share of the way to the gel's stiffness in a step: a sudden change drives the body.
FOLLOW = 0.5

# Least mean square radius of a contact, for the springs of the hinges, mm².
LEAST_TURN_MM2 = 4.0

# Damping over stiffness of the springs, s (with half of it a ball bounces on), and the largest
# share of its speed that a joint loses in a step: MuJoCo's contacts do not foresee the damping.
# With 1 and more hard presses swing without end, with a quarter dropped bodies are thrown off.
DAMPING_S, LARGEST_LOSS = 0.01, 0.5
STILL_MM = 0.02  # Least indentation for a secant, mm.

# Longest step of the gel, s: friction and creep take a traction as constant in it.
LONGEST_STEP_S = 0.02

# A held object lies between two pads, of which one is the sensor; how long it has been held
# before time zero, s, and in how many steps.
HELD_PADS, SETTLE_S, SETTLE_STEPS = 2.0, 4.0, 8


@dataclass(frozen=True)
class Reading:
    """What the sensor tells at one time, and what is behind it (simulated).

    Attributes:
        t_us: Time, us.
        displacement_px: ``(m, 2)`` displacement of the markers as it is told, px.
        coasted: ``(m,)`` True where a marker is predicted, not observed.
        true_px: ``(m, 2)`` true displacement of the markers, px.
        skin: The skin: ``force_n`` (x right, y down, z into the sensor), ``in_contact``.
    """

    t_us: int
    displacement_px: Floats
    coasted: NDArray[np.bool_]
    true_px: Floats
    skin: SkinState

    @property
    def slipping(self) -> float:
        """Share of the touched skin that slips, 0 to 1."""
        touching = np.unpackbits(self.skin.touching_cells).sum(dtype=float)
        sticking = np.unpackbits(self.skin.sticking_cells).sum(dtype=float)
        return 1.0 - sticking / touching if touching else 0.0


class Sensor:
    """One sensor of a compiled model.

    Args:
        model: The model, compiled after :func:`add_sensor`. The springs of the pad's joints are
            changed as the sensor is used.
        mount: What :func:`add_sensor` returned.
        fidelity: ``markers``: displacements with the tracker's measured noise, delay and losses;
            ``events``: the twin's event camera and the real tracker; ``ideal``: the true ones.
        followers: Pads that face this one across an object (turned about the site's y axis) and
            carry the same load: the second finger of a gripper, which nobody looks at.

    Attributes:
        mount: The pad.
        reference_px: ``(m, 2)`` markers at rest, px.
        observer: What sees the skin; with ``events`` its ``packet`` holds the latest events.

    Raises:
        ConfigError: The model has no such pad, or the fidelity is unknown.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        mount: Mount,
        fidelity: Fidelity = "markers",
        followers: Sequence[Mount] = (),
    ) -> None:
        if fidelity not in CELLS:
            raise st.ConfigError(f"fidelity is {fidelity!r}, valid are {', '.join(CELLS)}")
        try:
            self._geom, self._site = model.geom(mount.geom).id, model.site(mount.site).id
            self._plate = model.body(mount.body).id
            pads = [[model.joint(name) for name in pad.joints] for pad in (mount, *followers)]
        except KeyError as error:
            raise st.ConfigError(
                f"the model has no pad {mount.geom!r}; compile it after add_sensor"
            ) from error
        self._model, self.mount, self._fidelity = model, mount, fidelity
        self._joints = np.array([[joint.id for joint in six] for six in pads])
        self._optics = Optics(mount.optics, SkinConfig().serial)
        self._held = [g for g in self._geoms(self._plate) if g != self._geom]
        self._indenters: dict[int, BodyIndenter] = {}
        grid, self._t_s = GridConfig(cells=CELLS[fidelity]), np.nan
        self._gel, self._axis_mm = Gel(GelConfig(grid=grid), mount.rest_mm), grid.axis_mm
        self._state = self._gel.step(1e-3, None, None)
        self.reference_px = self._optics.project(self._state).center_px

    def _geoms(self, body: int) -> list[int]:
        return np.flatnonzero(self._model.geom_bodyid == body).tolist()

    def reset(self, data: mujoco.MjData, seed: int = 0) -> Reading:
        """Return to a skin at rest, or, where the pad holds something, to one long held.

        Args:
            data: State of the model, after ``mj_forward``.
            seed: Seed of what is random in the sensor.
        """
        self._body: int | None = self._plate if self._held else None
        self._t_s, self._zero, self._spring = data.time, np.zeros(6), self._stiffness_at_rest()
        self._center_mm = np.zeros(3)
        self._gel.reset()
        self._state = self._gel.step(1e-3, None, None)
        if self._held:
            for _ in range(SETTLE_STEPS):
                self._advance(data, SETTLE_S / SETTLE_STEPS)
            self._zero = self._wrench()
        self._couple(data)
        if self._fidelity == "events":
            self.observer = EventObserver(self.mount, self._optics, seed)
        else:
            ideal = self._fidelity == "ideal"
            self.observer = MarkerObserver(self.mount, self._optics, seed, ideal)
        return self._read(first=True)

    def step(self, data: mujoco.MjData) -> Reading:
        """Advance the sensor to the time of the model and return what it tells.

        Call it every 2 to 10 ms of the model's time, after ``mj_step``.

        Raises:
            ValueError: The time has not advanced, or by more than 20 ms.
        """
        dt_s = data.time - self._t_s
        if not 0.0 < dt_s <= LONGEST_STEP_S * (1.0 + 1e-9):
            raise ValueError(
                f"the model is {1e3 * dt_s:g} ms after the sensor's last step, valid are up to "
                f"{1e3 * LONGEST_STEP_S:g} ms; call reset(data) after a reset of the model"
            )
        self._t_s = data.time
        self._advance(data, dt_s)
        self._couple(data)
        return self._read()

    def _read(self, first: bool = False) -> Reading:
        state = replace(self._state, t_us=round(self._t_s * 1e6))
        seen = self.observer.begin(state) if first else self.observer.observe(state)
        return Reading(state.t_us, *seen, state)

    def _advance(self, data: mujoco.MjData, dt_s: float) -> None:
        """Step the gel under the body that touches."""
        if not self._held and not self._gel.in_contact:
            self._find_touch(data)
        touch = (None, None) if self._body is None else self._indenter(data, self._body)
        self._state = self._gel.step(dt_s, *touch)

    def _find_touch(self, data: mujoco.MjData) -> None:
        """Find the body that presses deepest on the pad, and the friction between them."""
        self._body = None
        pairs = data.contact.geom.reshape(-1, 2)
        mine = np.flatnonzero((pairs == self._geom).any(axis=1))
        if not len(mine):
            return
        first = mine[data.contact.dist[mine].argmin()]
        other = pairs[first].sum() - self._geom
        self._body = int(self._model.geom_bodyid[other])
        self._gel.contact.friction = float(data.contact.friction[first, 0])

    def _indenter(self, data: mujoco.MjData, body: int) -> tuple[BodyIndenter, st.Pose]:
        """Return a body and its pose in the frame of the skin, mm."""
        if body not in self._indenters:
            collides = self._model.geom_contype | self._model.geom_conaffinity
            geoms = self._held or [g for g in self._geoms(body) if collides[g]]
            self._indenters[body] = BodyIndenter(self._model, geoms, self.mount.pad_mm / 2.0)
        indenter = self._indenters[body]
        frame = np.array(AXES) @ data.site_xmat[self._site].reshape(3, 3).T
        rotation = frame @ data.xmat[body].reshape(3, 3)
        place = frame @ (data.xpos[body] - data.site_xpos[self._site]) * MM_PER_M
        indenter.place_mm = place.copy()
        place[2] -= indenter.center_mm(rotation)
        return indenter, st.Pose(position_mm=place, rotation=rotation, frame="skin")

    def _wrench(self) -> Floats:
        """Return force on the skin, and moment about the centre of pressure, N and N m."""
        pads, force_n = HELD_PADS if self._held else 1.0, self._state.force_n
        torque_n_mm = self._state.torque_n_mm - np.cross(self._center_mm, force_n)
        wrench = np.concatenate((force_n, torque_n_mm / MM_PER_M))
        return pads * wrench - self._zero

    def _couple(self, data: mujoco.MjData) -> None:
        """Make the springs as stiff as the gel, and place them so that they push with its force.

        The normal springs have their zero at the undeformed skin instead. The hinges lie at the
        centre of pressure: elsewhere a contact would tilt the plate, and meet less than the gel.
        """
        model = self._model
        self._spring += FOLLOW * (self._stiffness() - self._spring)
        sideways = SIDEWAYS & self._gel.in_contact & (not self._held)
        model.jnt_pos[self._joints[0, 3:]] = self._center_mm @ AXES / MM_PER_M
        for number, joints in enumerate(self._joints):
            qpos, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
            model.jnt_stiffness[joints] = self._spring.reshape(-1, *model.jnt_stiffness.shape[1:])
            most = LARGEST_LOSS * model.dof_armature[dofs] / model.opt.timestep
            damping = np.minimum(self._spring * DAMPING_S, most)
            model.dof_damping[dofs] = damping.reshape(-1, *model.dof_damping.shape[1:])
            data.qpos[qpos[sideways]] = 0.0
            zero = data.qpos[qpos] - self._wrench() * (MIRROR if number else 1.0) / self._spring
            model.qpos_spring[qpos] = np.where(sideways | bool(self._held), zero, 0.0)

    def _stiffness(self) -> Floats:
        """Return the stiffness of the gel along the six joints, N/m and N m/rad."""
        pressure = self._gel.pressure_mpa
        if not self._state.in_contact:
            return self._stiffness_at_rest()
        share = pressure / pressure.sum()
        depth_mm = max(STILL_MM, float(self._gel.displacement_mm[2].max()))
        normal = np.clip(MM_PER_M * float(self._state.force_n[2]) / depth_mm, *STIFFNESS_N_M)
        normal *= HELD_PADS if self._held else 1.0
        lateral = SHEAR_SHARE * normal
        along = np.array([share.sum(axis=1), share.sum(axis=0)])  # y, and x
        center_mm = along @ self._axis_mm
        square_mm2 = np.maximum(along @ self._axis_mm**2 - center_mm**2, LEAST_TURN_MM2)
        if not self._held:
            self._center_mm[:2] = center_mm[::-1]
        turn = np.append(normal * square_mm2, lateral * square_mm2.sum()) / MM_PER_M**2
        return np.array([lateral, lateral, normal, *turn])

    def _stiffness_at_rest(self) -> Floats:
        turn = LEAST_TURN_MM2 / MM_PER_M**2
        return STIFFNESS_N_M[0] * np.array([1.0, 1.0, 1.0, turn, turn, 2.0 * turn])
