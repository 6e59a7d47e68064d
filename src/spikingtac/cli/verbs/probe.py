"""``spikingtac probe``: find centre and radius of one hole by touch, on the twin or a real arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import spikingtac as st
from spikingtac import events
from spikingtac.atomic_files import write_json
from spikingtac.cli import probe_sites as sites
from spikingtac.cli.messages import Table, tell
from spikingtac.cli.probe_sites import Args, ProbedHole
from spikingtac.errors import named
from spikingtac.plots.circles import HolePicture, save_hole_plot
from spikingtac.schema import to_mapping

LEAST_RADIUS_MM = 0.5  # Radius of the narrowest hole of the twin, mm: the bit reaches 0.433 mm.
OF_AN_ARM = ("events", "calibration", "rehearsal", "gripper", "travel_mm", "travel_sigma_mm")
DIGITS = 5  # Decimals of lengths in hole.json, mm: a hundredth of a micrometre.


def run(args: Args) -> int:
    """Probe a hole, write the result, and print it."""
    check(args)
    paths = _output_paths(args)
    try:
        hole = sites.on_twin(args) if args.arm is None else sites.on_arm(args)
    except (KeyboardInterrupt, SystemExit):  # by the user; a fault leaves the folder
        if paths and not any(paths[0].parent.iterdir()):
            paths[0].parent.rmdir()
        raise
    circle, touches = hole.found.circle, hole.found.touches
    picture = HolePicture(
        circle=circle,
        reading_mm=np.array([touch.reading_mm for touch in touches]),
        true_center_mm=hole.true_center_mm,
        true_radius_mm=None if hole.true_center_mm is None else args.radius_mm,
    )
    summary, place = _summary(args, hole, picture), "simulated" if args.arm is None else "real arm"
    if paths:
        (x, y), sigma, radius = circle.center_mm, circle.sigma_mm, circle.radius_mm
        title = (
            f"hole by touch ({f'arm at {args.arm}' if args.arm else place}): "
            f"{len(touches)} contacts\n"
            f"centre ({x:.3f} ± {sigma[0]:.3f}, {y:.3f} ± {sigma[1]:.3f}) mm, "
            f"radius {radius:.3f} ± {sigma[2]:.3f} mm (one sigma)"
        )
        write_json(paths[0], _document(args, hole, picture))
        save_hole_plot(paths[1], title, picture)
        summary |= {"output": str(paths[0]), "picture": str(paths[1])}
    rows = [
        (name, summary[name], summary[f"{name}_sigma"], summary.get(f"{name}_error", "-"))
        for name in ("x_mm", "y_mm", "radius_mm")
    ]
    columns = ("", "estimate", "standard deviation", "error (simulated)")
    table = Table(f"hole from {len(touches)} contacts ({place})", columns, rows)
    return tell(args.json, summary, table, *([f"written: {paths[0]}, {paths[1]}"] if paths else []))


def check(args: Args) -> None:
    """Refuse invalid arguments before anything moves or is computed.

    Raises:
        ConfigError: Names the flag, what was given and what is valid.
    """
    from spikingtac.contact import detectors
    from spikingtac.robot.adaptive_search import LEAST_CONTACTS

    named(detectors(), args.detector, "contact detector")
    if not args.radius_mm >= LEAST_RADIUS_MM:
        raise st.ConfigError(
            f"--radius-mm is {args.radius_mm:g}; the bit reaches 0.433 mm and needs some room: "
            f"at least {LEAST_RADIUS_MM} mm"
        )
    on_twin = args.arm is None
    args.refuse("is used with --arm", *OF_AN_ARM, where=on_twin)
    args.refuse("is used on the twin, without --arm", "radius_mm", "seed", where=not on_twin)
    args.refuse("is used with --gripper", "release", where=not args.gripper)
    if args.arm is not None and (args.events is None or args.calibration is None):
        raise st.ConfigError(
            "--arm needs --events and --calibration: those of the finger that holds the probe"
        )
    if args.arm and args.events and not (args.rehearsal or events.is_stream(args.events)):
        raise st.ConfigError(
            f"--events is {str(args.events)!r}, which is no camera's named pipe: an arm that "
            "moves by a recording feels nothing. Give the pipe, or --rehearsal if nothing can "
            "be touched"
        )
    if args.contacts < LEAST_CONTACTS:
        raise st.ConfigError(f"contacts is {args.contacts}, it must be at least {LEAST_CONTACTS}")


def _output_paths(args: Args) -> tuple[Path, Path] | None:
    """Return the paths of document and picture, and create their folder.

    Raises:
        ConfigError: A file is named, or one of them is there already.
    """
    folder = args.output
    if folder is None:
        return None
    if folder.is_file() or (folder.suffix and not folder.is_dir()):
        raise st.ConfigError(f"--output is {str(folder)!r}; give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    args.claim(folder / "hole.json", folder / "hole.png")
    return folder / "hole.json", folder / "hole.png"


def _summary(args: Args, hole: ProbedHole, picture: HolePicture) -> dict[str, Any]:
    """Return what is printed: each coordinate with its sigma and its error."""
    circle = hole.found.circle
    values = {"": [*circle.center_mm, circle.radius_mm], "_sigma": list(circle.sigma_mm)}
    if picture.error_mm is not None:
        values["_error"] = list(picture.error_mm)
    told: dict[str, Any] = {"contacts": len(hole.found.touches)}
    for number, name in enumerate(("x_mm", "y_mm", "radius_mm")):
        told |= {f"{name}{kind}": round(float(of[number]), 4) for kind, of in values.items()}
    told |= {} if hole.grip is None else {"grip": hole.grip}
    return told | {"source": "robot" if args.arm else "twin", "simulated": args.arm is None}


def _document(args: Args, hole: ProbedHole, picture: HolePicture) -> dict[str, Any]:
    """Return the document that is written."""
    circle, travel, truth = hole.found.circle, hole.travel, None
    config = {"probing": args.probing(), "detector": args.detector, **hole.given}
    config["search"] = args.searching()
    contacts = [
        {name: _rounded(getattr(touch, name)) for name in ("start_mm", "direction", "reading_mm")}
        | {"residual_mm": _rounded(residual)}
        for touch, residual in zip(hole.found.touches, circle.residual_mm, strict=True)
    ]
    if picture.error_mm is not None:
        truth = {"center_mm": _rounded(hole.true_center_mm), "radius_mm": args.radius_mm}
        truth["error_mm"] = _rounded(picture.error_mm)
    return {
        "package_version": st.__version__,
        "simulated": args.arm is None,
        "arm": args.arm,
        "grip": hole.grip,
        "method": {"search": "default", "detector": args.detector},
        "center_mm": _rounded(circle.center_mm),
        "radius_mm": _rounded(circle.radius_mm),
        "sigma_mm": _rounded(circle.sigma_mm),
        "covariance_mm2": circle.covariance_mm2.tolist(),
        "contacts": contacts,
        "travel": {
            "harmonics_mm": _rounded(travel.harmonics_mm),
            "sigma_mm": _rounded(travel.sigma_mm),
            "across_flats_mm": travel.across_flats_mm,
            "heading_rad": travel.heading_rad,
        },
        "truth": truth,
        "config": to_mapping(config),
        "assumed": list(hole.assumed),
    }


def _rounded(values: Any) -> Any:
    return np.round(values, DIGITS).tolist()
