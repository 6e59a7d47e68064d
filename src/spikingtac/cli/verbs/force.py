"""``spikingtac force``: learn forces from labelled displacements, check them, apply them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

import spikingtac as st
from spikingtac import touch
from spikingtac.atomic_files import replacing
from spikingtac.cli.messages import Table, progress, tell
from spikingtac.cli.options import Output, WriteArgs
from spikingtac.events.formats.array_file import load_arrays
from spikingtac.touch.force.model import SIGMAS_90
from spikingtac.touch.series import labelled

MODEL = Path("force.onnx")
OF_A_GEL = ("thickness_mm", "camera_distance_mm", "calibration")  # Options of a fit without labels.
OF_A_FIT = ("shear_modulus_kpa", *OF_A_GEL)
UNUSED = {"fit": ("force",), "check": ("output", *OF_A_FIT), "apply": ("wrench", *OF_A_FIT)}

# Keys of a model's record that a summary leaves out.
NUMBERS = ("schema", "reference", "interval", "rest_radius", "memory")
ONE_SERIES = "note: one series; R2 is between its parts, a second series would be a harder test"

BEYOND = "note: {:.1%} of them press beyond the presses that were learned: intervals hold for less"


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Learn a force model from displacements with wrenches (fit), check or apply one.

    From labelled contacts: spikingtac force fit contacts_1.npz contacts_2.npz -o force.onnx

    Without labels: spikingtac force fit --shear-modulus-kpa 30 --calibration C -o force.onnx

    Checked: spikingtac force check contacts_3.npz --force force.onnx

    Applied: spikingtac force apply tracks.npz --force force.onnx -o tracks_with_forces.npz

    Each file is one series with its own zero: tracks of this package, or arrays t_us,
    reference_mm (m, 3), displacement_mm (n, m, 3). It holds a wrench (n, 6) in N and Nm, or the
    forces come from a file of their own.

    Attributes:
        action: fit makes a model, check compares one with the wrenches of a file, apply adds
            forces.
        files: Series of one sensor; for apply one file of tracks.
        wrench: Forces of each file that holds none: truth.npz, a simulation's folder, or a sensor's
            CSV (t_us or t_s, fx, fy, fz, mx, my, mz). Its clock is aligned by itself.
        force: check, apply: the model.
        output: fit: the model, force.onnx unless given; apply: tracks with force_n and
            force_sigma_n.
        base: fit: a model of another sensor, which is fitted to this one by the presses in the
            files.
        shear_modulus_kpa: fit: the skin's shear modulus, kPa; contacts are drawn from its
            equations.
        thickness_mm: With --shear-modulus-kpa: the skin's thickness, mm.
        camera_distance_mm: With --shear-modulus-kpa: from lens to skin, mm; perspective is
            neglected unless given.
        calibration: With --shear-modulus-kpa: calibration.json with a scale (made with --pitch-mm).
    """

    action: Annotated[
        tyro.conf.Positional[Literal["fit", "check", "apply"]], tyro.conf.arg(metavar="DO")
    ]
    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILES")] = ()
    wrench: tuple[Path, ...] = ()
    force: Path = MODEL
    output: Output = None
    base: Annotated[Path | None, tyro.conf.arg(aliases=["--from"])] = None
    shear_modulus_kpa: float | None = None
    thickness_mm: float = 3.0
    camera_distance_mm: float | None = None
    calibration: Path | None = None


def run(args: Args) -> int:
    """Fit, check or apply, and say how well the forces are known."""
    args.refuse(f"is not used to {args.action}", *UNUSED[args.action])
    args.refuse("needs --shear-modulus-kpa", *OF_A_GEL, where=args.shear_modulus_kpa is None)
    if not args.files and args.shear_modulus_kpa is None:
        raise st.ConfigError("no file was given; give files with displacements and wrenches")
    if args.base is not None and (args.action != "fit" or args.shear_modulus_kpa is not None):
        raise st.ConfigError("--from is used to fit, with labelled files alone")
    if args.wrench and len(args.wrench) != len(args.files):
        raise st.ConfigError(f"{len(args.wrench)} wrenches were given for {len(args.files)} files")
    return {"fit": _fit, "check": _check, "apply": _apply}[args.action](args)


def _series(args: Args) -> list[st.WrenchSeries]:
    series = [touch.load_series(path) for path in args.files]
    if not args.wrench:
        return series
    return [labelled(one, path) for one, path in zip(series, args.wrench, strict=True)]


def _fit(args: Args) -> int:
    from spikingtac.touch.force.fit import retarget

    output = MODEL if args.output is None else args.output
    args.claim(output, endings=(".onnx",))
    if args.base is not None:
        model = retarget(st.load_force(args.base), _series(args))
    else:
        with progress("learning forces") as advance:
            model = st.fit_force([*_series(args), *_drawn(args)], advance)
    model.save(output)
    told = {key: value for key, value in model.record.items() if key not in NUMBERS}
    table = Table(
        f"{output}: {told['kind']} from {told['frames']} frames of {len(told['series'])} series",
        ("component", "range", "R2 between series"),
        [
            (name, "{:g} to {:g}".format(*told["range"][name]), f"{r2:.3f}")
            for name, r2 in told["r2_between_series"].items()
        ],
    )
    notes = [ONE_SERIES] if len(told["series"]) == 1 else []
    return tell(args.json, {"output": str(output)} | told, table, *notes, f"written: {output}")


def _drawn(args: Args) -> list[st.WrenchSeries]:
    """Return contacts on a skin of known stiffness; none where it is not known."""
    if args.shear_modulus_kpa is None:
        return []
    if args.calibration is None:
        raise st.ConfigError("--shear-modulus-kpa needs --calibration: where the markers rest")
    calibration = st.Calibration.load(args.calibration)
    if calibration.px_per_mm is None:
        raise st.ConfigError(
            f"{str(args.calibration)!r} knows no scale; tell it how far markers are apart: "
            f"spikingtac calibrate {args.calibration} -o calibration.json --pitch-mm 2.4"
        )
    skin = touch.SkinConfig(
        shear_modulus_kpa=args.shear_modulus_kpa,
        thickness_mm=args.thickness_mm,
        camera_distance_mm=args.camera_distance_mm,
    )
    return touch.synthetic_series(skin, calibration.reference_px, calibration.px_per_mm)


def _check(args: Args) -> int:
    model = st.load_force(args.force)
    rows: list[dict[str, Any]] = [
        {**score._asdict(), "file": series.name}
        for series in _series(args)
        for score in touch.score_force(model, series)
    ]
    forms = ("{file}", "{component}", "{r2:.3f}", "{mae:.4f} {unit}", "{coverage90:.1%}")
    shown = [[form.format_map(row) for form in forms] for row in rows]
    columns = ("file", "component", "R2", "mean abs. error", "in 90 % interval")
    table = Table(f"{args.force.name} against measured forces", columns, shown, words=2)
    return tell(args.json, {"rows": rows}, table)


def _apply(args: Args) -> int:
    if len(args.files) != 1 or args.output is None:
        raise st.ConfigError("apply takes one file of tracks, --force F and -o OUT")
    args.claim(args.output, endings=(".npz",))
    model = st.load_force(args.force)
    values, half_widths = model.estimate(touch.load_series(args.files[0]))
    columns = {"force_n": values[:, :3], "force_sigma_n": half_widths[:, :3] / SIGMAS_90}
    if values.shape[1] > 3:
        columns["torque_nm"] = values[:, 3:]
    kept: dict[str, Any] = load_arrays(args.files[0], "tracks")
    kept |= {name: column.astype(np.float32) for name, column in columns.items()}
    with replacing(args.output) as partial, partial.open("wb") as file:
        np.savez_compressed(file, **kept)
    peak_n = float(np.sqrt((values[:, :3] ** 2).sum(axis=1)).max())
    summary = {"output": str(args.output), "frames": len(values), "peak_force_n": round(peak_n, 4)}
    notes = [f"written: {args.output}, {len(values)} frames, at most {peak_n:.2f} N"]
    limits = np.array([*model.record["range"].values()]).T
    if beyond := float(((values < limits[0]) | (values > limits[1])).any(axis=1).mean()):
        notes.append(BEYOND.format(beyond))
    return tell(args.json, summary | {"beyond_learned": round(beyond, 4)}, *notes)
