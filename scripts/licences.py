"""List the licences of the installed dependencies of the extras named, and what is not permissive.

python scripts/licences.py [EXTRA ...]
"""

import re
import sys
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = "spikingtac"

# Licences that ask the same of what uses them.
RECIPROCAL = re.compile(r"(?<!L)GPL|Affero|General Public", re.IGNORECASE)


def main() -> int:
    """Print name, version and licence; return 1 where one is not permissive."""
    found: dict[str, Distribution] = {}
    collect(PROJECT, set(sys.argv[1:]), found)
    doubtful = 0
    for name, installed in sorted(found.items()):
        licence = licence_of(installed)
        doubtful += bool(RECIPROCAL.search(licence))
        print(f"{name}\t{installed.version}\t{licence}")
    return int(doubtful > 0)


def collect(name: str, extras: set[str], found: dict[str, Distribution]) -> None:
    """Add what a package needs, with these extras of it, and what that needs."""
    for text in distribution(name).requires or []:
        needed = Requirement(text)
        key, marker = canonicalize_name(needed.name), needed.marker
        asked = marker is None or any(marker.evaluate({"extra": one}) for one in ("", *extras))
        if asked and key == PROJECT:
            collect(PROJECT, needed.extras, found)
        elif asked and key not in found:
            with suppress(PackageNotFoundError):  # not installed
                found[key] = distribution(key)
                collect(key, needed.extras, found)


def licence_of(installed: Distribution) -> str:
    """Return what a package says of its licence, in one line."""
    about = installed.metadata
    named = about.get("License-Expression")
    classes = [
        line.rpartition(":: ")[2]
        for line in about.get_all("Classifier", [])
        if line.startswith("License ::")
    ]
    text = named or "; ".join(classes) or (about.get("License") or "not stated")
    return text.strip().splitlines()[0][:100]


if __name__ == "__main__":
    sys.exit(main())
