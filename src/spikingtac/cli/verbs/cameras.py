"""``spikingtac cameras``: what is plugged in, and how each kind of camera is addressed."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from spikingtac.cameras.libraries import is_installed, plugged_in, remedy
from spikingtac.cli.messages import Table, tell
from spikingtac.cli.options import JsonArgs
from spikingtac.events.camera import KINDS


@dataclass(frozen=True, kw_only=True)
class Args(JsonArgs):
    """List the cameras that are plugged in, and the ways to reach one; nothing is opened.

    An address is accepted wherever a recording is: view, track, calibrate, contact, touch, probe,
    convert, info, and record.
    """


def run(args: Args) -> int:
    """Print what is there, and what is missing."""
    found = list(plugged_in())
    kinds = {
        name: {
            "example": kind.example,
            "about": kind.about,
            "library": kind.module or None,
            "installed": is_installed(name),
        }
        for name, kind in KINDS.items()
    }
    document = {"found": [asdict(item) for item in found], "kinds": kinds}
    shown: list[Table | str] = [
        f"note: {item.model} could not look for cameras ({item.remark})"
        for item in found
        if not item.address
    ]
    seen = [(one.address, one.model, one.serial, one.remark) for one in found if one.address]
    if seen:
        shown.append(Table("plugged in", ("address", "model", "serial", "remark"), seen, words=4))
    else:
        shown.append("no camera is plugged in, or the library that would see it is missing")
    ways = [
        (one["example"], one["about"], "" if one["installed"] else remedy(name))
        for name, one in kinds.items()
    ]
    columns = ("address, as", "what it reads", "missing")
    return tell(
        args.json, document, *shown, Table("ways to reach a camera", columns, ways, words=3)
    )
