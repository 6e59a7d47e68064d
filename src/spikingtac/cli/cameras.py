"""``spikingtac cameras``: what is plugged in, and how each kind of camera is addressed."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from spikingtac.cli.messages import emit_json, emit_table, remark
from spikingtac.cli.options import JsonArgs


@dataclass(frozen=True, kw_only=True)
class Args(JsonArgs):
    """List the cameras that are plugged in, and the ways to reach one; nothing is opened.

    An address is accepted wherever a recording is: view, track, calibrate, contact, touch, probe,
    convert, info, and record.
    """


def run(args: Args) -> int:
    """Print what is there, and what is missing."""
    from spikingtac.cameras.found import is_installed, plugged_in, remedy
    from spikingtac.events.cameras.kinds import KINDS

    found = list(plugged_in())
    if args.json:
        kinds = {
            name: {
                "example": kind.example,
                "about": kind.about,
                "library": kind.module or None,
                "installed": is_installed(name),
            }
            for name, kind in KINDS.items()
        }
        emit_json({"found": [asdict(item) for item in found], "kinds": kinds})
        return 0
    for item in found:
        if not item.address:
            remark(f"note: {item.model} could not look for cameras ({item.remark})")
    found = [item for item in found if item.address]
    if found:
        rows = [(item.address, item.model, item.serial, item.remark) for item in found]
        emit_table("plugged in", ("address", "model", "serial", "remark"), rows, words=4)
    else:
        remark("no camera is plugged in, or the library that would see it is missing")
    rows = [
        (kind.example, kind.about, "" if is_installed(name) else remedy(name))
        for name, kind in KINDS.items()
    ]
    emit_table("ways to reach a camera", ("address, as", "what it reads", "missing"), rows, words=3)
    return 0
