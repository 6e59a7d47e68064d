"""The grasped probe: a rigid rod between gel pads, whose tip meets a wall; and what shakes it.

The pads are a bushing with six degrees of freedom: elastic, creeping, lightly damped. The inertia
of the rod moves it when the arm vibrates or accelerates. Each step is implicit (backward Euler), so
that a rigid contact at the tip is one small problem in the compliance of the tip.

Frames: the gripper's (x along pad A's image x, y along the rod towards the tip, z = x cross y, from
pad A to pad B) for the bushing; the robot's base for arm, tip, wall and force. Units N, mm, s.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import expm

from spikingtac.sim.gel import CREEP_FRACTIONS, CREEP_TIMES_S
from spikingtac.sim.rig.walls import Bit, TipContact, Wall
from spikingtac.types import FloatArray

# Stiffness of translation, N/mm, and of rotation across the rod, N mm/rad (contract.md).
K_T_N_MM, K_THETA_N_MM_RAD = 2.5, 68.0

# Stiffness about the rod's own axis, N mm/rad (k_theta (7/18)²: width instead of length).
TORSION_N_MM_RAD = 10.3
STICKOUT_MM = 40.0  # Distance from the patch's centre to the tip, mm (contract.md).
GRIP_MM = 9.0  # Length of the rod behind the patch's centre, mm.

# The gripper's axes as columns: x = base x, y (to the tip) = down, z = base y.
GRIPPER_IN_BASE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])

# Displacement of the tip per bushing motion, base frame: ``(3, 6)``.
_LEVER = STICKOUT_MM * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
TIP_JACOBIAN = GRIPPER_IN_BASE @ np.hstack([np.eye(3), _LEVER])
TONNE_PER_GRAM = 1e-6  # Mass unit of the N, mm, s system is the tonne.
GRAMS_PER_MM = 0.099  # Line density of the rod, g/mm (steel, 4 mm thick).

# Damping ratio of the rod's rocking mode, in addition to creep (a range of 0.05 to 0.2).
DAMPING_RATIO = 0.1

# Resonance of the arm, Hz, and its Q (contract.md, "Pinned physics").
RESONANCE_HZ, QUALITY = 15.0, 5.0

# Covariance of (x, x') for unit variance of x.
STATIONARY = np.diag([1.0, (2.0 * np.pi * RESONANCE_HZ) ** 2])


@dataclass(frozen=True, kw_only=True)
class Grasp:
    """One grasp of the probe: its tip, and the bushing (contract.md, "Pinned physics").

    Attributes:
        normal_ratio: Stiffness across the pads' planes divided by that along them; 1 as pinned,
            about 7 for the patch of the layer model.
        tilt_ratio: The same for rotation out of the pads' plane; about 4 for the layer model.
        tip_friction: Coefficient of friction between tip and wall (steel on plastic).
        bit: Shape of the tip.
    """

    normal_ratio: float = 1.0
    tilt_ratio: float = 1.0
    tip_friction: float = 0.3
    bit: Bit = field(default_factory=Bit)

    @classmethod
    def of(cls, seed: int) -> Grasp:
        """Draw a grasp (assumed: ratios 0.8 to 1.5, friction 0.2 to 0.4, any heading)."""
        rng = np.random.default_rng([seed, 1])
        return cls(
            bit=Bit(heading_rad=float(rng.uniform(0.0, np.pi / 3))),
            normal_ratio=float(rng.uniform(0.8, 1.5)),
            tilt_ratio=float(rng.uniform(0.8, 1.5)),
            tip_friction=float(rng.uniform(0.2, 0.4)),
        )


@dataclass(frozen=True, slots=True)
class ProbeState:
    """The probe at one time.

    Attributes:
        t_us: Time, us.
        tip_mm: ``(3,)`` position of the tip, base frame, mm.
        center_mm: ``(3,)`` centre of the patch, base frame, mm.
        bushing: ``(6,)`` translation (mm) and rotation (rad) of the rod against the pads, gripper
            frame, about the patch's centre.
        force_n: ``(3,)`` force of the wall on the tip, base frame, N.
        gap_mm: Smallest distance of the tip from the wall, mm.
        free_gap_mm: The same if the wall exerted no force. A negative value is the penetration that
            the wall prevents.
        in_contact: True if the wall exerts a force.
    """

    t_us: int
    tip_mm: FloatArray
    center_mm: FloatArray
    bushing: FloatArray
    force_n: FloatArray
    gap_mm: float
    free_gap_mm: float
    in_contact: bool


class Probe:
    """Advances the rod, its bushing and the contact at its tip.

    Args:
        grasp: The rod and its bushing.
        wall: The wall that the tip can touch.
        arm_mm: ``(3,)`` initial position of the arm, mm.

    Attributes:
        contact: Contact between tip and wall.
    """

    def __init__(self, grasp: Grasp, wall: Wall, arm_mm: FloatArray) -> None:
        self.contact = TipContact(grasp.bit, wall, grasp.tip_friction)
        self._grasp = grasp
        self._bushing = np.zeros(6)
        self._rate = np.zeros(6)
        self._creep = np.zeros((len(CREEP_FRACTIONS), 6))
        self._arm = [np.array(arm_mm, np.float64)] * 2
        self._arm_dt_s = np.inf

    def step(self, t_us: int, dt_s: float, arm_mm: FloatArray) -> ProbeState:
        """Advance by ``dt_s`` to ``t_us``, at which the arm is at ``arm_mm`` ``(3,)``."""
        springs, moved, chain = step_matrices(self._grasp, round(dt_s * 1e9))
        (stiffness, damping, mass), (compliance, from_tip, tip_compliance) = springs, moved
        decay, gain = chain
        creep = decay @ self._creep
        momentum = self._bushing / dt_s**2 + self._rate / dt_s
        load = stiffness * creep + damping * self._bushing / dt_s + mass @ momentum
        # The arm's acceleration over the last two steps.
        before, last = self._arm
        rate = (arm_mm - last) / dt_s - (last - before) / self._arm_dt_s
        self._arm, self._arm_dt_s = [last, np.array(arm_mm)], dt_s
        load -= mass[:, :3] @ (GRIPPER_IN_BASE.T @ rate / dt_s)
        free_bushing = compliance @ load
        force = self.contact.solve(arm_mm + TIP_JACOBIAN @ free_bushing, tip_compliance)
        bushing = free_bushing + from_tip @ force
        self._creep = decay[:, None] * self._creep + gain * (stiffness * (bushing - creep))
        self._rate, self._bushing = (bushing - self._bushing) / dt_s, bushing
        tip_mm = arm_mm + TIP_JACOBIAN @ bushing
        pressed, free_gap = bool(force.any()), self.contact.free_gap_mm
        gaps = self.contact.gap_mm(tip_mm) if pressed else free_gap, free_gap
        return ProbeState(t_us, tip_mm, self._center(arm_mm), bushing, force, *gaps, pressed)

    def at_rest(self, t_us: int) -> ProbeState:
        """Return the state before the first step: unloaded and without contact."""
        arm_mm, still = self._arm[-1], (np.zeros(6), np.zeros(3))
        gap = self.contact.gap_mm(arm_mm)
        return ProbeState(t_us, arm_mm, self._center(arm_mm), *still, gap, gap, False)

    def relocated(self, state: ProbeState, shift_mm: FloatArray) -> ProbeState:
        """Return the state after the arm was moved by ``shift_mm`` at once. The rod swings on."""
        self._arm = [place + shift_mm for place in self._arm]
        tip_mm, center_mm = state.tip_mm + shift_mm, state.center_mm + shift_mm
        gap = self.contact.gap_mm(tip_mm)
        return replace(state, tip_mm=tip_mm, center_mm=center_mm, gap_mm=gap, free_gap_mm=gap)

    def _center(self, arm_mm: FloatArray) -> FloatArray:
        return arm_mm - GRIPPER_IN_BASE[:, 1] * STICKOUT_MM


@functools.lru_cache(maxsize=64)
def step_matrices(grasp: Grasp, dt_ns: int) -> tuple[tuple[FloatArray, ...], ...]:
    """Return the matrices of a step of a length in nanoseconds.

    Returns:
        Stiffness and damping ``(6,)`` of the degrees of freedom, and mass ``(6, 6)``; motion of the
        bushing per load ``(6, 6)``, of bushing ``(6, 3)`` and tip ``(3, 3)`` per force at the tip;
        decay ``(c,)`` of the creep chain, and its gain ``(c, 6)`` per elastic force.
    """
    dt_s = dt_ns * 1e-9
    decay = np.exp(-dt_s / CREEP_TIMES_S)
    stiffness0 = bushing_stiffness(grasp)
    stiffness = stiffness0 / (1.0 + CREEP_FRACTIONS @ (1.0 - decay))
    mass = rod_inertia()
    omega = np.sqrt(K_THETA_N_MM_RAD / mass[3, 3]) if mass[3, 3] > 0.0 else np.inf
    damping = stiffness0 * 2.0 * DAMPING_RATIO / omega
    whole = np.diag(stiffness + damping / dt_s) + mass / dt_s**2
    compliance = np.linalg.inv(whole).astype(np.float64)
    gain = ((1.0 - decay) * CREEP_FRACTIONS)[:, None] / stiffness0
    mobility = TIP_JACOBIAN @ compliance
    motion = compliance, mobility.T.copy(), mobility @ TIP_JACOBIAN.T
    return (stiffness, damping, mass), motion, (decay, gain)


def bushing_stiffness(grasp: Grasp) -> FloatArray:
    """Return the instantaneous stiffness ``(6,)`` in the gripper frame (N/mm and N mm/rad)."""
    along, tilt = K_T_N_MM * grasp.normal_ratio, K_THETA_N_MM_RAD * grasp.tilt_ratio
    return np.array([K_T_N_MM, K_T_N_MM, along, tilt, TORSION_N_MM_RAD, K_THETA_N_MM_RAD])


def rod_inertia() -> FloatArray:
    """Return the mass matrix ``(6, 6)`` of the rod about the patch's centre (tonne, mm)."""
    front, back = STICKOUT_MM, GRIP_MM
    mass = GRAMS_PER_MM * (front + back) * TONNE_PER_GRAM
    center = (front - back) / 2.0
    moment = mass * (front**2 - front * back + back**2) / 3.0
    out = np.diag([mass, mass, mass, moment, moment * 1e-3, moment])
    out[0, 5] = out[5, 0] = -mass * center
    out[2, 3] = out[3, 2] = mass * center
    return out


class Vibration:
    """Three independent axes of x'' + (w/Q) x' + w^2 x = white noise, in their stationary state.

    The transition over a step is exact, so that the statistics do not depend on its length.

    Args:
        rms_mm: Root mean square of each axis, mm.
        rng: Source of the noise.
    """

    def __init__(self, rms_mm: float, rng: np.random.Generator) -> None:
        self._rms_mm = rms_mm
        self._rng = rng
        self._state = np.linalg.cholesky(STATIONARY) @ rng.standard_normal((2, 3))

    @property
    def offset_mm(self) -> FloatArray:
        """Displacement ``(3,)`` of the tool now, mm."""
        return self._rms_mm * self._state[0]

    def advance(self, dt_s: float) -> FloatArray:
        """Step by ``dt_s`` and return the new displacement ``(3,)``, mm."""
        if self._rms_mm > 0.0:
            move, noise = transition(round(dt_s * 1e9))
            self._state = move @ self._state + noise @ self._rng.standard_normal((2, 3))
        return self.offset_mm


@functools.lru_cache(maxsize=64)
def transition(dt_ns: int) -> tuple[FloatArray, FloatArray]:
    """Return the exact transition of a step ``(2, 2)`` and a root of its noise's covariance."""
    omega = 2.0 * np.pi * RESONANCE_HZ
    system = np.array([[0.0, 1.0], [-(omega**2), -omega / QUALITY]])
    whole = np.asarray(expm(system * dt_ns * 1e-9), np.float64)
    return whole, np.linalg.cholesky(STATIONARY - whole @ STATIONARY @ whole.T).astype(np.float64)
