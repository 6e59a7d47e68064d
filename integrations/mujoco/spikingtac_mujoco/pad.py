"""The sensor's pad in a model: a plate on six springs, which are the gel's compliance."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

import spikingtac as st
from spikingtac.sim import OpticsConfig, SkinConfig, load_camera

Floats = NDArray[np.float64]

# Thickness of gel and skin (contract.md, "Pinned physics").
THICKNESS_MM = 3.0
# Valid sides of a pad, mm: the gel is solved on a square of 26 mm.
PAD_MM = (4.0, 24.0)
# How far the pad goes on beyond the outer markers, in pitches (19.2 mm for 8 x 8).
RIM_PITCHES = 0.5
# Mass of the plate, kg (20 x 20 x 3 mm of silicone weigh 1.3 g).
PLATE_KG = 0.002
# Inertia of the slides, kg, and of the hinges, kg m². MuJoCo's contacts give way in
# proportion to the inverse of the lightest mass; on the plate's 2 g they would be softer than gel.
ARMATURE = (0.05, 3e-6)
# MuJoCo's softness between plate and object: 0.01 mm/N, so that the springs are what gives way.
SOLREF, SOLIMP = (0.004, 1.0), (0.99, 0.99, 0.0002, 0.5, 2.0)
# Weight of the pad's softness against the object's; friction stays the larger one of the two.
SOLMIX = 1e3
# Friction of the skin (contract.md), and about the normal and in rolling, m: 2/3 of it times 3 mm,
# the radius of a usual patch, and next to nothing.
FRICTION, TURNING_M = 0.8, (0.002, 0.0001)
# The skin's axes (x right, y down in the image, z into the sensor) in the frame of the site.
AXES = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
# Names in the model, after that of the site.
PLATE, SKIN = "pad", "skin"
JOINTS = ("slide_x", "slide_y", "slide_z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True)
class Mount:
    """A sensor that was added to a model.

    Attributes:
        site: Name of the site: centre of the skin at rest, z out of the sensor.
        body: Name of the plate's body; geoms that are added to it are held by the sensor.
        joints: Names of its joints: three slides and three hinges along the skin's axes.
        geom: Name of the pad's geom.
        pad_mm: ``(2,)`` sides of the pad, mm.
        rest_mm: ``(m, 2)`` markers at rest (x right, y down), mm.
        grid: Rows and columns of the markers.
        camera: Preset of the twin's event camera.
        optics: Lens of the twin.
    """

    site: str
    body: str
    joints: tuple[str, ...]
    geom: str
    pad_mm: Floats
    rest_mm: Floats
    grid: tuple[int, int]
    camera: str
    optics: OpticsConfig


def load_spec(path: str | Path) -> mujoco.MjSpec:
    """Read an MJCF file.

    Raises:
        ConfigError: The file is missing or is no MJCF.
    """
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise st.ConfigError(f"{str(path)!r} is no model that MuJoCo reads: {error}") from error


def add_sensor(
    spec: mujoco.MjSpec,
    *,
    site: str,
    calibration: st.Calibration | str | Path | None = None,
    pad_mm: tuple[float, float] | None = None,
    camera: str = "typical",
    friction: float = FRICTION,
) -> Mount:
    """Add a sensor to a model: a pad whose outer face is centred at a site, across its z axis.

    The plate moves on springs against the body of the site, so the model gets six joints. Address
    joints by name; keyframes are carried over.

    Args:
        spec: The model, not compiled yet.
        site: Where the skin is; its z axis points out of the sensor.
        calibration: The sensor whose markers are felt, or its file; the twin's 8 by 8 unless given.
        pad_mm: Sides of the pad; half a pitch beyond the outer markers unless given.
        camera: Preset of the twin's event camera: ``clean``, ``typical`` or ``noisy``.
        friction: Friction of the skin. Of a pair MuJoCo takes the larger one, so that an object
            slips more easily only where this is lower.

    Raises:
        ConfigError: There is no such site or camera, the calibration has no scale, the pad is too
            small or too large, or the friction is negative.
    """
    place = spec.site(site)
    if place is None:
        names = ", ".join(repr(one.name) for one in spec.sites if one.name) or "none"
        raise st.ConfigError(
            f"the model has no site {site!r}; it has {names}; add one where the skin is to be: "
            f'<site name="{site}" pos="..." zaxis="..."/>, z out of the sensor'
        )
    load_camera(camera)  # refuses one that is not known
    if not 0.0 <= friction < np.inf:
        raise st.ConfigError(f"friction is {friction:g}, it must be a number of at least 0")
    rest_mm, grid, optics = _markers(calibration)
    sides = np.array(pad_mm) if pad_mm is not None else _sides_mm(rest_mm)
    if sides.shape != (2,) or not ((sides >= PAD_MM[0]) & (sides <= PAD_MM[1])).all():
        raise st.ConfigError(
            f"the pad is {' x '.join(map('{:g}'.format, sides.flat))} mm, valid are "
            f"{PAD_MM[0]:g} to {PAD_MM[1]:g} mm a side; give pad_mm=(width, height), or a scale"
        )
    mount = Mount(
        site=site,
        body=f"{site}_{PLATE}",
        joints=tuple(f"{site}_{name}" for name in JOINTS),
        geom=f"{site}_{SKIN}",
        pad_mm=sides,
        rest_mm=rest_mm,
        grid=grid,
        camera=camera,
        optics=optics,
    )
    kept = _keyframes(spec)
    _add_plate(place, mount, friction)
    _restore_keyframes(spec, kept)
    return mount


def _markers(
    calibration: st.Calibration | str | Path | None,
) -> tuple[Floats, tuple[int, int], OpticsConfig]:
    """Return markers at rest (mm), their grid and the lens that sees them."""
    if calibration is None:
        skin = SkinConfig()
        return skin.rest_mm(), skin.grid, OpticsConfig()
    if not isinstance(calibration, st.Calibration):
        calibration = st.Calibration.load(calibration)
    scale = calibration.skin_scale
    if scale is None or calibration.px_per_mm is None or calibration.grid is None:
        raise st.ConfigError(
            "the calibration has no scale or no grid; make it with: spikingtac calibrate RECORDING "
            "--pitch-mm 2.4 -o calibration.json"
        )
    rest_mm = scale.to_mm(calibration.reference_px)
    optics = OpticsConfig(size=calibration.size, px_per_mm=calibration.px_per_mm)
    return rest_mm - rest_mm.mean(axis=0), calibration.grid, optics


def _sides_mm(rest_mm: Floats) -> Floats:
    apart = np.linalg.norm(rest_mm[:, None] - rest_mm[None], axis=2)
    pitch_mm = np.median(np.sort(apart, axis=1)[:, 1]) if len(rest_mm) > 1 else PAD_MM[0]
    return np.round(np.ptp(rest_mm, axis=0) + 2.0 * RIM_PITCHES * pitch_mm, 3)


def _add_plate(place: mujoco.MjsSite, mount: Mount, friction: float) -> None:
    """Attach the plate; made in a model of its own, so that no default of the user's applies."""
    plate = mujoco.MjSpec().worldbody.add_body(name=PLATE)
    kinds = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for number, name in enumerate(JOINTS):
        turns, axis = divmod(number, len(AXES))
        plate.add_joint(name=name, type=kinds[turns], axis=AXES[axis], armature=ARMATURE[turns])
    half = np.append(mount.pad_mm, THICKNESS_MM) / 2e3
    plate.add_geom(
        name=SKIN,
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        pos=(0.0, 0.0, -half[2]),
        mass=PLATE_KG,
        condim=4,
        friction=(friction, *TURNING_M),
        solmix=SOLMIX,
        solref=SOLREF,
        solimp=SOLIMP,
        rgba=(0.1, 0.1, 0.12, 1.0),
    )
    place.attach_body(plate, f"{mount.site}_", "")


def _keyframes(spec: mujoco.MjSpec) -> list[dict[str, Floats]]:
    """Return each keyframe as positions of joints by name, and forget its vector."""
    if not spec.keys:
        return []
    model = spec.copy().compile()
    joints = range(model.njnt)
    kept = [{model.joint(j).name: _of_joint(model, j, q) for j in joints} for q in model.key_qpos]
    for key in spec.keys:
        key.qpos, key.qvel = [], []
    return kept


def _restore_keyframes(spec: mujoco.MjSpec, kept: list[dict[str, Floats]]) -> None:
    model = spec.copy().compile() if kept else None
    for key, places in zip(spec.keys, kept, strict=True):
        qpos = model.qpos0.copy()
        for name, place in places.items():
            _of_joint(model, model.joint(name).id, qpos)[:] = place
        key.qpos = qpos


def _of_joint(model: mujoco.MjModel, joint: int, qpos: Floats) -> Floats:
    """Return the part of a vector of positions that is a joint's (a view)."""
    ends = [*model.jnt_qposadr, model.nq]
    return qpos[ends[joint] : ends[joint + 1]]
