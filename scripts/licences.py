"""List the licences of the installed dependencies of the extras named, and what is not permissive.

python scripts/licences.py [EXTRA ...]
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, PackageNotFoundError, distribution

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
    """Add what a package needs, and what that needs."""
    try:
        needed = distribution(name).requires or []
    except PackageNotFoundError:
        return
    for requirement in needed:
        wanted = re.match(r"[A-Za-z0-9._-]+", requirement)
        asked = re.findall(r"extra\s*==\s*['\"]([^'\"]+)", requirement)
        if wanted is None or (asked and not extras & set(asked)):
            continue
        key = re.sub(r"[-_.]+", "-", wanted.group()).lower()
        inner = re.match(r"[A-Za-z0-9._-]+\[([^\]]*)\]", requirement)
        if key == PROJECT and inner:
            collect(PROJECT, set(inner.group(1).replace(" ", "").split(",")), found)
        elif key not in found:
            try:
                found[key] = distribution(key)
            except PackageNotFoundError:
                continue
            collect(key, set(), found)


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
