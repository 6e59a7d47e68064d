"""Read the attributes of an HDF5 file's objects, in a process that can be ended.

A damaged attribute can make the HDF5 library search without end, where nothing in the same process
can interrupt it. Run as a program this prints the attributes as JSON; it imports h5py alone, since
it is started for every file.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Longest search for attributes (ours: a sound file needs 0.3 s, the start of Python included).
TIME_LIMIT_S = 20.0

# Attributes that tell a sensor's size, in the files of Metavision, of this package and of DSEC.
NAMES = ("geometry", "width", "height", "sensor_resolution")

LONGEST_VALUE = 64  # Characters of a value that is told; what is longer is no size.


def read_attributes(path: Path, objects: Sequence[str]) -> list[dict[str, Any]]:
    """Return the attributes of each object that are among ``NAMES``: numbers, lists, strings.

    Args:
        path: The file.
        objects: Absolute names of groups and data sets in it.

    Raises:
        ValueError: They cannot be read, or not within ``TIME_LIMIT_S``; says so.
    """
    command = [sys.executable, "-P", __file__, str(path), *objects]
    try:
        done = subprocess.run(
            command, capture_output=True, check=False, stdin=subprocess.DEVNULL,
            timeout=TIME_LIMIT_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise ValueError(f"no end of its attributes within {TIME_LIMIT_S:g} s") from None
    if done.returncode:
        told = done.stderr.decode(errors="replace").strip().splitlines()
        raise ValueError(
            f"its attributes cannot be read: {told[-1] if told else 'the reader died'}"
        )
    return list(json.loads(done.stdout))


def _told(value: Any) -> Any:
    plain = getattr(value, "tolist", lambda: value)()
    plain = plain.decode(errors="replace") if isinstance(plain, bytes) else plain
    return plain if len(str(plain)) <= LONGEST_VALUE else None


def _main(path: str, *objects: str) -> None:
    import h5py

    with h5py.File(path, "r") as file:
        every = [file[name].attrs for name in objects]
        found = [{name: _told(at[name]) for name in NAMES if name in at} for at in every]
    sys.stdout.write(json.dumps(found, default=str))


if __name__ == "__main__":
    _main(*sys.argv[1:])
