"""Compute a sensor from its parameters, check it, and write its parts and drawings."""

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from spikingtac.cli import Table, WriteArgs, progress, tell


@dataclass(frozen=True, kw_only=True)
class Args(WriteArgs):
    """Compute a sensor from its parameters, check it, and write its parts and drawings.

    Without -o the figures and checks are printed, which needs nothing beyond the plain install.
    With -o the parts (STEP, STL, DXF), drawings, pictures, bill of materials and build guide are
    written, which needs: pip install 'spikingtac[design]'. No sensor was built from them yet.

    Attributes:
        design: Name of a design (see --list), or the path of a TOML file.
        output: Folder to write.
        list: Print the designs, one per line: name, two spaces, description.
    """

    design: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DESIGN")] = "paper-size"
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FOLDER")] = None
    list: bool = False


def run(args: Args) -> int:
    """Print the figures and checks of a design, and write its files."""
    from spikingtac_hardware.checks import require_sound
    from spikingtac_hardware.design import descriptions, load_design
    from spikingtac_hardware.figures import figures_of

    if args.list:
        if args.json:
            return tell(True, {"designs": descriptions()})
        sys.stdout.writelines(f"{name}  {about}\n" for name, about in descriptions().items())
        return 0
    design = load_design(args.design)
    findings = require_sound(design)
    if args.output is None:
        figures: dict[str, Any] = figures_of(design)
    else:
        from spikingtac_hardware.write import write_design

        with progress(f"designing {args.design}") as advance:
            figures = write_design(design, args.output, args.overwrite, advance)
    folder = {} if args.output is None else {"folder": str(args.output)}
    checks = [{**asdict(one), "passed": one.passed} for one in findings]
    document = {"design": args.design, **folder, "figures": figures, "checks": checks}
    computed = Table(f"{args.design}, computed", ("figure", "value"), _rows(figures))
    rows = [(finding.name, finding.reason) for finding in findings]
    last: Table | str = Table(f"{len(rows)} checks passed", ("check", "what was found"), rows, 2)
    if args.output is not None:
        last = f"{args.output}: {figures['files']} files; begin with build-guide.md"
    return tell(args.json, document, computed, last)


def _rows(figures: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for name, value in figures.items():
        if isinstance(value, dict):
            yield from _rows({f"{name}.{inner}": number for inner, number in value.items()})
        elif isinstance(value, list):
            yield name, " x ".join(f"{number:.4g}" for number in value)
        else:
            yield name, f"{value:.5g}" if isinstance(value, float) else str(value)
