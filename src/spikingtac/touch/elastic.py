"""A bonded elastic layer: its surface under traction, and contacts drawn on it at random.

Where the skin's stiffness is known, its equations say how the markers move under any pressure and
shear. A force model that learns from such contacts needs no force sensor.

The layer is incompressible, linear and isotropic, bonded to a rigid base, of thickness h. Frame: x
right, y down, z into the layer (towards the camera), so that pressure and indentation are positive.
All responses are for unit shear modulus; multiply by the compliance 1/mu.

The response to a point force is a sum of Bessel functions of the layer's response over all
wavenumbers (a Hankel transform); a disc of pressure smooths it. The layer has no sides: markers
nearer to the rim of a real skin than its thickness move less than this says.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import jv

from spikingtac.errors import ConfigError
from spikingtac.schema import require_within
from spikingtac.touch.series import N_MM_PER_NM, WrenchSeries
from spikingtac.types import KPA_PER_MPA, FloatArray

# Limit of kh, before cosh overflows; 1/cosh² is zero in double precision long before.
MAX_ARGUMENT = 300.0


def layer_response(
    wavenumber_per_mm: FloatArray, thickness_mm: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return surface displacements per traction exp(i k x), mm at unit modulus.

    They are: normal under pressure; outward under pressure, as the factor of ``-i k/|k|``; lateral
    under lateral traction, along the wave, then across it. With x = kh and D = cosh² x + x²: normal
    (sinh x cosh x - x) / (2 k D), outward x² / (2 k D), along (sinh x cosh x + x) / (2 k D), across
    tanh(x) / k; at k = 0 the layer only shears: 0, 0, h, h. Derived from the Stokes form of
    incompressible elasticity and tested against a numeric solution of its equations.

    Args:
        wavenumber_per_mm: Wavenumbers k, any shape, 1/mm, not negative.
        thickness_mm: Thickness h, mm.
    """
    flat = wavenumber_per_mm <= 0.0
    k = np.where(flat, 1.0, wavenumber_per_mm)
    x = np.minimum(k * thickness_mm, MAX_ARGUMENT)
    tanh, sech2 = np.tanh(x), 1.0 / np.cosh(x) ** 2
    scale = 0.5 / (k * (1.0 + x**2 * sech2))
    normal = np.where(flat, 0.0, (tanh - x * sech2) * scale)
    along = np.where(flat, thickness_mm, (tanh + x * sech2) * scale)
    across = np.where(flat, thickness_mm, tanh / k)
    return normal, np.where(flat, 0.0, x**2 * sech2 * scale), along, across


WAVENUMBERS = 400  # Steps of the integral over wavenumbers (800 give the same to 1e-4).

# Largest wavenumber times smoothing radius; the smoothing leaves exp(-32) there.
LARGEST_ARGUMENT = 8.0
TABLE_POINTS = 400  # Distances at which the response is tabulated; in between it is linear.


@dataclass(frozen=True, kw_only=True)
class SkinConfig:
    """An elastic skin, bonded to a rigid window.

    Attributes:
        shear_modulus_kpa: Shear modulus mu at once, kPa.
        thickness_mm: Thickness, mm.
        camera_distance_mm: From the lens's centre of projection to the skin at rest, mm. Where the
            skin is pressed towards the camera, markers move away from the middle of the image, as
            much as a press moves them along the skin. None where this is not seen.
    """

    shear_modulus_kpa: float = 30.0
    thickness_mm: float = 3.0
    camera_distance_mm: float | None = None

    def __post_init__(self) -> None:
        require_within(self, shear_modulus_kpa=(0.1, 1e5), thickness_mm=(0.1, 50.0))
        if self.camera_distance_mm is not None and not self.camera_distance_mm > self.thickness_mm:
            raise ConfigError(
                f"camera_distance_mm is {self.camera_distance_mm}, it must be more than the "
                f"skin's thickness, {self.thickness_mm} mm: the camera looks through the gel"
            )


class SurfaceResponse:
    """Displacement of the surface per unit force at a place, for one skin.

    Forces are spread as a Gaussian of the given radius, so that nothing is infinite.
    """

    def __init__(self, skin: SkinConfig, radius_mm: float, reach_mm: float) -> None:
        """Tabulate the responses up to a distance.

        Args:
            skin: The skin.
            radius_mm: Standard deviation of the Gaussian over which a force is spread, mm.
            reach_mm: Largest distance asked for, mm.
        """
        compliance = KPA_PER_MPA / skin.shear_modulus_kpa
        largest = LARGEST_ARGUMENT / radius_mm
        k = (np.arange(WAVENUMBERS) + 0.5) * largest / WAVENUMBERS
        normal, outward, along, across = layer_response(k, skin.thickness_mm)
        weight = compliance * np.exp(-0.5 * (k * radius_mm) ** 2) * k / (2.0 * np.pi)
        weight = weight * largest / WAVENUMBERS
        self._distance = np.linspace(0.0, reach_mm, TABLE_POINTS)
        zero, first, second = (jv(order, self._distance[:, None] * k) for order in (0, 1, 2))
        # Outward and inward under pressure; along the force, and twofold about it.
        self._tables = (
            first @ (weight * outward),
            zero @ (weight * normal),
            zero @ (weight * (0.5 * (along + across))),
            -second @ (weight * (0.5 * (along - across))),
        )

    def matrix(self, places_mm: FloatArray, sources_mm: FloatArray) -> FloatArray:
        """Return the response at places to forces at sources.

        Args:
            places_mm: ``(m, 2)`` markers at rest, mm (x right, y down).
            sources_mm: ``(c, 2)`` where forces act, mm.

        Returns:
            ``(m, 3, c, 3)`` displacement along x, along y and towards the camera, mm per N along
            x, along y and pressing.
        """
        away = places_mm[:, None] - sources_mm[None]
        distance = np.sqrt((away**2).sum(axis=2))
        cosine, sine = np.moveaxis(away / np.maximum(distance, 1e-9)[..., None], -1, 0)
        outward, deep, even, twofold = (
            np.interp(distance, self._distance, table) for table in self._tables
        )
        c2, s2 = cosine**2 - sine**2, 2.0 * cosine * sine
        # By reciprocity a lateral force lifts a place as much as pressing there would move it.
        rows = (
            (even + twofold * c2, twofold * s2, outward * cosine),
            (twofold * s2, even - twofold * c2, outward * sine),
            (-outward * cosine, -outward * sine, deep),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


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
LARGEST_KEPT = 0.5  # Largest share of the spreading under pressure that a stuck patch keeps.

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
    reference_px: FloatArray,
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
        asked = rng, sources, own, modulus_mpa, number % PARTS
        force = np.array([_contact(*asked) for _ in range(frames)])
        moved = force.reshape(frames, -1) @ at_markers.T
        moved, depth = np.split(moved.reshape(frames, -1, 3), [2], axis=2)
        if skin.camera_distance_mm is not None:
            nearer = skin.camera_distance_mm / (skin.camera_distance_mm - depth[..., 0])
            moved = (places + moved) * nearer[..., np.newaxis] - places
        moved += rng.normal(0.0, NOISE_MM, moved.shape)
        t_us = np.arange(frames, dtype=np.int64) * US_PER_FRAME
        (x, y), (fx, fy, fz) = sources.T, force.transpose(2, 0, 1)
        moment = np.column_stack([fz @ y, -fz @ x, fy @ x - fx @ y]) / N_MM_PER_NM
        wrench, name = np.hstack([force.sum(axis=1), moment]), f"synthetic {number + 1}"
        out.append(WrenchSeries(t_us, reference_px, moved * px_per_mm, wrench, "px", name))
    return out


def _contact(
    rng: np.random.Generator, sources: FloatArray, own: FloatArray, modulus_mpa: float, part: int
) -> FloatArray:
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


def _rotation(angle_rad: float) -> FloatArray:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def _stuck_shear(
    own: FloatArray, pressing: FloatArray, moved: FloatArray, kept: float
) -> FloatArray:
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
