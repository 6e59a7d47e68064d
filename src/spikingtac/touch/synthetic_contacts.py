"""Contacts that need no measurement: random patches on an elastic layer and their forces.

Where the skin's stiffness is known, its equations say how the markers move under any pressure and
shear. A force model that learns from such contacts needs no force sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spikingtac.touch.elastic import KPA_PER_MPA, SkinConfig, SurfaceResponse
from spikingtac.touch.force.series import WrenchSeries

Field = NDArray[np.float64]

N_MM_PER_NM = 1e3
US_PER_FRAME = 1_000

# Distance between the places at which forces act, mm (ours: a third of a marker's pitch).
SOURCE_PITCH_MM = 0.9

# Radius over which each is spread, in those distances (ours: their sum is smooth to 1 %).
SPREAD = 0.6

# Reach of the table of responses: of the longer side of the marker field, and mm beyond it (ours:
# no two places of a square field are farther apart than 1.42 sides).
REACH_SHARE, REACH_MARGIN_MM = 1.6, 5.0
CENTER_SHARE = 0.8  # Share of the marker field on which contacts are centred.

# Powers of one less the radius squared: Hertz twice, a flatter and a more pointed pressure.
PROFILE_POWERS = (0.5, 0.5, 0.2, 1.0)

# Largest displacement of a stuck patch, mm (ours: beyond it every patch slides).
LARGEST_DRAG_MM = 1.8
LARGEST_TWIST_RAD = 1.2  # Largest turn of a stuck patch, rad.
LARGEST_KEPT = 0.5  # Largest share of the spreading under pressure that a stuck patch keeps (ours).

# Share of the mean response that is added before solving for the shear: spread forces overlap.
STUCK_RIDGE = 0.02
SMALLEST_MM = 0.8  # Smallest semi-axis of a patch, mm.

# Largest mean pressure over the shear modulus (ours: a layer is indented by two thirds of its
# thickness at 3.3; what is pressed deeper is not learned).
LARGEST_PRESSURE = 3.3
REST_SHARE = 0.05  # Share of the frames that are rest.


@dataclass(frozen=True, kw_only=True)
class SyntheticContactConfig:
    """Which contacts are drawn.

    Attributes:
        frames: Contacts in a series.
        series: Parts of the range of sizes; the contacts of a series are drawn from its part and
            the one below, those of the first from the first alone.
        rounds: Series of each part (ours: with twice as many contacts the normal force errs by an
            eighth to a fifth less on 60 validation contacts; the fit takes three times as long).
        largest_mm: Largest semi-axis of a patch, mm.
        friction: Largest ratio of shear to pressure.
        noise_mm: Error of a marker's place, per axis, mm (ours: 0.15 px of the tracker).
    """

    frames: int = 3000
    series: int = 3
    rounds: int = 2
    largest_mm: float = 5.0
    friction: float = 0.8
    noise_mm: float = 0.01


def synthetic_series(
    skin: SkinConfig,
    reference_px: Field,
    px_per_mm: float,
    seed: int = 0,
    config: SyntheticContactConfig | None = None,
) -> list[WrenchSeries]:
    """Return series of contacts on a skin, as a tracker would see them.

    Args:
        skin: The skin.
        reference_px: ``(m, 2)`` markers at rest, px. Their mean is taken for the middle of the
            image, from which nearness moves markers away.
        px_per_mm: Scale of the image.
        seed: Seed of the contacts.
        config: Which contacts are drawn.
    """
    config = config or SyntheticContactConfig()
    rng = np.random.default_rng(seed)
    places = (reference_px - reference_px.mean(axis=0)) / px_per_mm
    sources = _sources(places)
    reach = float(np.ptp(places, axis=0).max()) * REACH_SHARE + REACH_MARGIN_MM
    response = SurfaceResponse(skin, SPREAD * SOURCE_PITCH_MM, reach)
    patches = _Patches(skin, sources, response)
    out = []
    for number in range(config.series * config.rounds):
        part = number % config.series
        force = np.array([_contact(patches, rng, config, part) for _ in range(config.frames)])
        moved = _moved_mm(force, places, sources, response, skin.camera_distance_mm)
        moved += rng.normal(0.0, config.noise_mm, moved.shape)
        out.append(_series(moved, force, sources, reference_px, px_per_mm, number))
    return out


def _moved_mm(
    force: Field,
    places: Field,
    sources: Field,
    response: SurfaceResponse,
    camera_distance_mm: float | None,
) -> Field:
    """Return how ``(m, 2)`` places move in the image under forces ``(n, c, 3)``, ``(n, m, 2)``."""
    flat = force.reshape(len(force), -1)
    along = flat @ response.matrix(places, sources).reshape(2 * len(places), -1).T
    along = along.reshape(len(force), -1, 2)
    if camera_distance_mm is None:
        return along
    depth = flat @ response.depth_matrix(places, sources).reshape(len(places), -1).T
    nearer = camera_distance_mm / (camera_distance_mm - depth)
    return (places + along) * nearer[..., np.newaxis] - places


def _sources(places: Field) -> Field:
    low, high = places.min(axis=0), places.max(axis=0)
    x, y = (np.arange(low[axis], high[axis] + 1e-9, SOURCE_PITCH_MM) for axis in (0, 1))
    return np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])


def _contact(
    patches: _Patches, rng: np.random.Generator, config: SyntheticContactConfig, number: int
) -> Field:
    """Return the forces ``(c, 3)`` of a contact that is pressed, then dragged and twisted."""
    sources = patches.sources
    if rng.random() < REST_SHARE:
        return np.zeros((len(sources), 3))
    edges = np.geomspace(SMALLEST_MM, config.largest_mm, config.series + 1)
    axes = rng.uniform(edges[max(number - 1, 0)], edges[number + 1], 2)
    center = sources[rng.integers(len(sources))] * CENTER_SHARE
    turn = rng.uniform(0.0, np.pi)
    away = sources - center
    along = away @ _rotation(turn)
    inside = np.maximum(1.0 - ((along / np.maximum(axes, SOURCE_PITCH_MM)) ** 2).sum(axis=1), 0.0)
    profile = inside ** rng.choice(PROFILE_POWERS)
    mean = LARGEST_PRESSURE * patches.shear_modulus_mpa * rng.uniform(0.02, 1.0)
    pressing = profile / max(float(profile.sum()), 1e-9) * mean * np.pi * axes[0] * axes[1]
    heading, drag = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 1.0) ** 2 * LARGEST_DRAG_MM
    twist = rng.uniform(-1.0, 1.0) * LARGEST_TWIST_RAD * (rng.random() < 0.5)
    moved = drag * np.array([np.cos(heading), np.sin(heading)])
    moved = moved + away @ (_rotation(twist) - np.eye(2)).T
    kept = rng.uniform(0.0, LARGEST_KEPT)
    shear = patches.stuck_shear(pressing, moved, kept, config.friction)
    return np.column_stack([shear, pressing])


def _rotation(angle_rad: float) -> Field:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


class _Patches:
    """The response of the skin to itself: which shear holds a patch in place."""

    def __init__(self, skin: SkinConfig, sources: Field, response: SurfaceResponse) -> None:
        self.sources = sources
        self.shear_modulus_mpa = skin.shear_modulus_kpa / KPA_PER_MPA
        self._own = response.matrix(sources, sources)

    def stuck_shear(self, pressing: Field, moved: Field, kept: float, friction: float) -> Field:
        """Return the shear forces ``(c, 2)`` under which a pressed patch moves as it is told.

        Args:
            pressing: ``(c,)`` pressing forces, N.
            moved: ``(c, 2)`` wanted displacement of the patch, mm.
            kept: Share of what pressing alone moves that stays: skin moves until it is touched.
            friction: Largest ratio of shear to pressing.
        """
        touched = np.flatnonzero(pressing > 0.0)
        shear = np.zeros((len(pressing), 2))
        if not len(touched):
            return shear
        own = self._own[touched][:, :, touched]
        pressed = own[..., 2] @ pressing[touched]
        count = 2 * len(touched)
        matrix = own[..., :2].reshape(count, count)
        stuck = np.linalg.solve(
            matrix + STUCK_RIDGE * np.trace(matrix) / count * np.eye(count),
            (moved[touched] - (1.0 - kept) * pressed).ravel(),
        ).reshape(-1, 2)
        length = np.maximum(np.sqrt((stuck**2).sum(axis=1)), 1e-12)
        shear[touched] = stuck * np.minimum(friction * pressing[touched] / length, 1.0)[:, None]
        return shear


def _series(
    moved: Field,
    force: Field,
    sources: Field,
    reference_px: Field,
    px_per_mm: float,
    number: int,
) -> WrenchSeries:
    frames = len(moved)
    total = force.sum(axis=1)
    x, y = sources.T
    fx, fy, fz = force.transpose(2, 0, 1)
    moment = np.column_stack([fz @ y, -fz @ x, fy @ x - fx @ y]) / N_MM_PER_NM
    return WrenchSeries(
        np.arange(frames, dtype=np.int64) * US_PER_FRAME,
        reference_px,
        moved * px_per_mm,
        np.hstack([total, moment]),
        "px",
        f"synthetic {number + 1}",
    )
