"""The options of ``spikingtac calibrate``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from spikingtac.cli.many import ManyArgs
from spikingtac.markers.calibration.lattice import LayoutKind
from spikingtac.markers.calibration.reference import Method
from spikingtac.types import Polarity


@dataclass(frozen=True, kw_only=True)
class Args(ManyArgs):
    """Learn where the markers rest, how large they are and what an event stands for.

    Any recording will do in which the markers move: presses, contacts or slides. It is best when
    it begins without load, when every marker moves by more than its diameter, and when the skin
    rests for half a second between contacts.

    A calibration.json in the place of the recording, with --pitch-mm: set its scale afterwards.
    With --check, whether recordings come from the sensor of a calibration; many go into a folder:
    spikingtac calibrate --check left_finger.json DAY -o DAY_checked --workers 4
    """

    recordings: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RECORDING")
    ]
    """Event file, recording folder, or a camera: its address, a named pipe, or -; or a calibration,
    to set its scale. With --check also several, a folder of recordings or a pattern such as
    'day/*.raw'."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="CALIBRATION")] = None
    """Write no calibration: say whether the recordings fit this one."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("calibration.json")
    """File to write; with --check the folder for many."""
    grid: Annotated[str | None, tyro.conf.arg(metavar="ROWSxCOLUMNS")] = None
    """Size of the grid, as 8x8; found by itself unless given."""
    layout: LayoutKind = "auto"
    """How the markers lie: in rows and columns, in rows of which every second one is shifted, or
    freely (their neighbours decide, there are no rows). Grids and staggered rows are told apart."""
    pitch_mm: float | None = None
    """Distance of neighbouring markers on the skin, mm; gives px_per_mm."""
    lens: bool = False
    """With --pitch-mm, on a flat skin: fit the lens's distortion and the camera's tilt to the grid,
    so that millimetres hold at the rim, too."""
    polarity: Literal["auto"] | Polarity = "auto"
    """White markers on dark ground, or dark on light; found by itself unless given."""
    method: Method = "rest-mean"
    """How the reference is computed from the rests; bounding-box is the published one."""
    allow_missing: int | None = None
    """Largest number of missing markers: they are put where the others expect them. A third of them
    may be missing unless given."""
    plot: Path | None = None
    """Picture to write: the markers as circles, good and doubtful ones in different colours."""
    guide: bool = False
    """Say every two seconds which markers still have to move, as is always done for a camera."""
    until_ready: bool = False
    """End a camera by itself once every marker has moved enough and the skin rests."""
