"""``spikingtac force``: learn forces from labelled displacements, and check what was learned."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from spikingtac.atomic_files import require_free
from spikingtac.cli.messages import emit_json, emit_table, progress, remark
from spikingtac.errors import ConfigError

if TYPE_CHECKING:
    from spikingtac.touch.force.model import ForceModel
    from spikingtac.touch.force.wrench_series import WrenchSeries


@dataclass(frozen=True, kw_only=True)
class Args:
    """Learn a force model from displacements with wrenches (fit), or check one (check).

    From labelled contacts: spikingtac force fit contacts_1.npz contacts_2.npz -o force.json

    Without labels: spikingtac force fit --shear-modulus-kpa 30 --calibration C -o force.json

    From both: spikingtac force fit contacts_1.npz --shear-modulus-kpa 30 --calibration C

    Checked: spikingtac force check contacts_3.npz --force force.json

    Each file is one series with its own zero: tracks of this package, or arrays t_us,
    reference_mm (m, 3), displacement_mm (n, m, 3). It holds a wrench (n, 6) in N and Nm, or the
    forces come from a file of their own.
    """

    action: Annotated[tyro.conf.Positional[Literal["fit", "check"]], tyro.conf.arg(metavar="DO")]
    """fit makes a model, check compares a model with the wrenches of a file."""
    files: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="FILES")] = ()
    """Series of one sensor."""
    wrench: tuple[Path, ...] = ()
    """Forces of each file where it holds none: truth.npz or the folder of a simulation, or the CSV
    of a force sensor (t_us or t_s, fx, fy, fz, mx, my, mz), whose clock is aligned by itself."""
    force: Path = Path("force.json")
    """check: the model."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("force.json")
    """fit: the file to write."""
    shear_modulus_kpa: float | None = None
    """fit: the skin's shear modulus, kPa; contacts are drawn from its equations, instead of files
    or beside them."""
    thickness_mm: float = 3.0
    """With --shear-modulus-kpa: the skin's thickness, mm."""
    camera_distance_mm: float | None = None
    """With --shear-modulus-kpa: from the centre of the camera's lens to the skin at rest, mm. What
    is pressed nearer to the camera moves outwards in the image; that is neglected unless given."""
    calibration: Path | None = None
    """With --shear-modulus-kpa: calibration.json with a scale (made with --pitch-mm)."""
    creep_fractions: tuple[float, ...] = ()
    """fit: retarded compliances of the skin over its instant one."""
    creep_times_s: tuple[float, ...] = ()
    """fit: their times, s; the creep of an old force is taken off with them."""
    depth: bool = False
    """fit: use the third coordinate of the displacements too."""
    overwrite: bool = False
    """fit: replace a file that is there."""
    json: bool = False
    """Print one JSON object on stdout."""


def run(args: Args) -> int:
    """Fit or check, and say how well the forces are known."""
    if args.shear_modulus_kpa is not None and args.action == "check":
        raise ConfigError("--shear-modulus-kpa is used to fit; check needs files and --force")
    if args.shear_modulus_kpa is None and args.camera_distance_mm is not None:
        raise ConfigError("--camera-distance-mm needs --shear-modulus-kpa")
    if not args.files and args.shear_modulus_kpa is None:
        raise ConfigError("no file was given; give files with displacements and wrenches")
    if args.wrench and len(args.wrench) != len(args.files):
        raise ConfigError(f"{len(args.wrench)} wrenches were given for {len(args.files)} files")
    return _fit(args) if args.action == "fit" else _check(args)


def _series(args: Args) -> list[WrenchSeries]:
    from spikingtac.touch.force.files.labels_file import labelled, load_labels
    from spikingtac.touch.force.files.series_file import load_series

    series = [load_series(path) for path in args.files]
    if not args.wrench:
        return series
    return [labelled(one, load_labels(path)) for one, path in zip(series, args.wrench, strict=True)]


def _fit(args: Args) -> int:
    from spikingtac.touch.force.creep_memory import CreepConfig
    from spikingtac.touch.force.files.model_file import save_force
    from spikingtac.touch.force.fit import fit_force

    require_free(args.output, args.overwrite)
    creep = CreepConfig(fractions=args.creep_fractions, times_s=args.creep_times_s)
    with progress("learning forces"):
        model = fit_force(_series(args), drawn=_drawn(args), depth=args.depth, creep=creep)
    save_force(model, args.output)
    summary = {"output": str(args.output), "unit": model.unit} | model.about
    if args.json:
        emit_json(summary)
        return 0
    _print_fit(model, args)
    return 0


def _drawn(args: Args) -> list[WrenchSeries]:
    """Return contacts on a skin of known stiffness; none where it is not known."""
    if args.shear_modulus_kpa is None:
        return []
    from spikingtac.calibration.sensor_calibration import Calibration
    from spikingtac.touch.elastic.surface_response import SkinConfig
    from spikingtac.touch.elastic.synthetic_contacts import synthetic_series

    if args.calibration is None:
        raise ConfigError("--shear-modulus-kpa needs --calibration: where the skin's markers rest")
    calibration = Calibration.load(args.calibration)
    if calibration.px_per_mm is None:
        raise ConfigError(
            f"{str(args.calibration)!r} knows no scale; make one with: "
            "spikingtac calibrate RECORDING -o calibration.json --pitch-mm 2.4"
        )
    skin = SkinConfig(
        shear_modulus_kpa=args.shear_modulus_kpa,
        thickness_mm=args.thickness_mm,
        camera_distance_mm=args.camera_distance_mm,
    )
    return synthetic_series(skin, calibration.reference_px, calibration.px_per_mm)


def _check(args: Args) -> int:
    from spikingtac.touch.force.files.model_file import load_force
    from spikingtac.touch.force.score import score_force

    model = load_force(args.force)
    rows: list[dict[str, Any]] = []
    for series in _series(args):
        _, _, distance = model.estimate(series)
        beyond = float((distance > 1.0).mean())
        if beyond > 0.0:
            remark(f"note: {beyond:.0%} of {series.name} is unlike anything that was learned")
        rows += [
            {**asdict(score), "file": series.name, "extrapolated": beyond}
            for score in score_force(model, series)
        ]
    if args.json:
        emit_json({"rows": rows})
        return 0
    emit_table(
        f"{args.force.name} against measured forces",
        ("file", "component", "R2", "mean abs. error", "in 90 % interval"),
        [
            (
                row["file"],
                row["component"],
                f"{row['r2']:.3f}",
                f"{row['mae']:.4f} {row['unit']}",
                f"{row['coverage90']:.1%}",
            )
            for row in rows
        ],
        words=2,
    )
    return 0


def _print_fit(model: ForceModel, args: Args) -> None:
    about = model.about
    emit_table(
        f"{args.output} from {about['frames']} frames of {len(about['series'])} series",
        ("component", "law", "range", "R2 between series"),
        [
            (
                name,
                law.name,
                "{:g} to {:g}".format(*about["range"][name]),
                f"{about['r2_between_series'][name]:.3f}",
            )
            for name, law in zip(model.components, model.laws, strict=True)
        ],
        words=2,
    )
    if len(about["series"]) == 1:
        remark("note: one series; R2 is between its parts, a second series would be a harder test")
