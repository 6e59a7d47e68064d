"""Contacts that need no measurement: random patches on an elastic layer and their forces.

Where the skin's stiffness is known, its equations say how the markers move under any pressure and
shear. A force model that learns from such contacts needs no force sensor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.elastic import KPA_PER_MPA, SkinConfig, SurfaceResponse
from spikingtac.touch.series import WrenchSeries

Field = NDArray[np.float64]

N_MM_PER_NM = 1e3
US_PER_FRAME = 1_000

# Distance between the places at which forces act, mm (a third of a marker's pitch).
SOURCE_PITCH_MM = 0.9

# Radius over which each is spread, in those distances (their sum is smooth to 1 %).
SPREAD = 0.6

# Reach of the table of responses: of the longer side of the marker field, and mm beyond it
# (no two places of a square field are farther apart than 1.42 sides).
REACH_SHARE, REACH_MARGIN_MM = 1.6, 5.0
CENTER_SHARE = 0.8  # Share of the marker field on which contacts are centred.

# Powers of one less the radius squared: Hertz twice, a flatter and a more pointed pressure.
PROFILE_POWERS = (0.5, 0.5, 0.2, 1.0)

# Largest displacement of a stuck patch, mm (beyond it every patch slides).
LARGEST_DRAG_MM = 1.8
LARGEST_TWIST_RAD = 1.2  # Largest turn of a stuck patch, rad.
LARGEST_KEPT = 0.5  # Largest share of the spreading under pressure that a stuck patch keeps .

# Share of the mean response that is added before solving for the shear: spread forces overlap.
STUCK_RIDGE = 0.02
SMALLEST_MM = 0.8  # Smallest semi-axis of a patch, mm.

# Largest mean pressure over the shear modulus (a layer is indented by two thirds of its
# thickness at 3.3; what is pressed deeper is not learned).
LARGEST_PRESSURE = 3.3
REST_SHARE = 0.05  # Share of the frames that are rest.

# Contacts in a series; parts of the range of sizes, each series being drawn from its part and the
# one below; and series of each part (with twice as many contacts the normal force errs by an
# eighth to a fifth less on 60 validation contacts; the fit takes three times as long).
FRAMES, PARTS, ROUNDS = 3_000, 3, 2
LARGEST_MM = 5.0  # Largest semi-axis of a patch, mm.
FRICTION = 0.8  # Largest ratio of shear to pressure.
NOISE_MM = 0.01  # Error of a marker's place, per axis, mm (0.15 px of the tracker).


def synthetic_series(
    skin: SkinConfig,
    reference_px: Field,
    px_per_mm: float,
    seed: int = 0,
    frames: int = FRAMES,
) -> list[WrenchSeries]:
    """Return series of contacts on a skin, as a tracker would see them.

    Args:
        skin: The skin.
        reference_px: ``(m, 2)`` markers at rest, px. Their mean is taken for the middle of the
            image, from which nearness moves markers away.
        px_per_mm: Scale of the image.
        seed: Seed of the contacts.
        frames: Contacts in each of the six series.
    """
    rng = np.random.default_rng(seed)
    places = (reference_px - reference_px.mean(axis=0)) / px_per_mm
    axes = (np.arange(one.min(), one.max() + 1e-9, SOURCE_PITCH_MM) for one in places.T)
    sources = np.column_stack([axis.ravel() for axis in np.meshgrid(*axes)])
    reach = float(np.ptp(places, axis=0).max()) * REACH_SHARE + REACH_MARGIN_MM
    response = SurfaceResponse(skin, SPREAD * SOURCE_PITCH_MM, reach)
    at_markers, own = response.matrix(places, sources), response.matrix(sources, sources)[:, :2]
    at_markers = at_markers.reshape(3 * len(places), -1)
    modulus_mpa, out = skin.shear_modulus_kpa / KPA_PER_MPA, []
    for number in range(PARTS * ROUNDS):
        part = number % PARTS
        force = np.array([_contact(rng, sources, own, modulus_mpa, part) for _ in range(frames)])
        moved = force.reshape(frames, -1) @ at_markers.T
        moved, depth = np.split(moved.reshape(frames, -1, 3), [2], axis=2)
        if skin.camera_distance_mm is not None:
            nearer = skin.camera_distance_mm / (skin.camera_distance_mm - depth[..., 0])
            moved = (places + moved) * nearer[..., np.newaxis] - places
        moved += rng.normal(0.0, NOISE_MM, moved.shape)
        t_us = np.arange(frames, dtype=np.int64) * US_PER_FRAME
        wrench, name = _wrench(force, sources), f"synthetic {number + 1}"
        out.append(WrenchSeries(t_us, reference_px, moved * px_per_mm, wrench, "px", name))
    return out


def _contact(
    rng: np.random.Generator, sources: Field, own: Field, modulus_mpa: float, part: int
) -> Field:
    """Return the forces ``(c, 3)``, N, of a contact that is pressed, then dragged and twisted."""
    if rng.random() < REST_SHARE:
        return np.zeros((len(sources), 3))
    edges = np.geomspace(SMALLEST_MM, LARGEST_MM, PARTS + 1)
    axes = rng.uniform(edges[max(part - 1, 0)], edges[part + 1], 2)
    center = sources[rng.integers(len(sources))] * CENTER_SHARE
    turn = rng.uniform(0.0, np.pi)
    away = sources - center
    along = away @ _rotation(turn)
    inside = np.maximum(1.0 - ((along / np.maximum(axes, SOURCE_PITCH_MM)) ** 2).sum(axis=1), 0.0)
    profile = inside ** rng.choice(PROFILE_POWERS)
    mean = LARGEST_PRESSURE * modulus_mpa * rng.uniform(0.02, 1.0)
    pressing = profile / max(float(profile.sum()), 1e-9) * mean * np.pi * axes[0] * axes[1]
    heading, drag = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 1.0) ** 2 * LARGEST_DRAG_MM
    twist = rng.uniform(-1.0, 1.0) * LARGEST_TWIST_RAD * (rng.random() < 0.5)
    moved = drag * np.array([np.cos(heading), np.sin(heading)])
    moved = moved + away @ (_rotation(twist) - np.eye(2)).T
    shear = _stuck_shear(own, pressing, moved, rng.uniform(0.0, LARGEST_KEPT))
    return np.column_stack([shear, pressing])


def _rotation(angle_rad: float) -> Field:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def _stuck_shear(own: Field, pressing: Field, moved: Field, kept: float) -> Field:
    """Return the shear forces ``(c, 2)`` under which a pressed patch moves as it is told.

    Args:
        own: ``(c, 2, c, 3)`` response of the skin at the sources to forces there, mm/N.
        pressing: ``(c,)`` pressing forces, N.
        moved: ``(c, 2)`` wanted displacement of the patch, mm.
        kept: Share of what pressing alone moves that stays: skin moves until it is touched.
    """
    touched = np.flatnonzero(pressing > 0.0)
    shear = np.zeros((len(pressing), 2))
    if not len(touched):
        return shear
    own = own[touched][:, :, touched]
    pressed, count = own[..., 2] @ pressing[touched], 2 * len(touched)
    matrix = own[..., :2].reshape(count, count)
    ridge = STUCK_RIDGE * np.trace(matrix) / count * np.eye(count)
    wanted = (moved[touched] - (1.0 - kept) * pressed).ravel()
    stuck = np.linalg.solve(matrix + ridge, wanted).reshape(-1, 2)
    length = np.maximum(np.sqrt((stuck**2).sum(axis=1)), 1e-12)
    shear[touched] = stuck * np.minimum(FRICTION * pressing[touched] / length, 1.0)[:, None]
    return shear


def _wrench(force: Field, sources: Field) -> Field:
    """Return forces, N, and moments, Nm, ``(n, 6)`` of forces ``(n, c, 3)`` at sources, mm."""
    x, y = sources.T
    fx, fy, fz = force.transpose(2, 0, 1)
    moment = np.column_stack([fz @ y, -fz @ x, fy @ x - fx @ y]) / N_MM_PER_NM
    return np.hstack([force.sum(axis=1), moment])
