"""Which recordings are meant, and which file each result goes to."""

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from spikingtac.errors import ConfigError
from spikingtac.events.camera import is_address
from spikingtac.events.open import READABLE
from spikingtac.file_kinds import RECORDING_NAME, members_of

# Endings of many kinds of tables: in a folder they are no recordings, by name they may be.
TABLES = frozenset({".csv", ".txt"})
BAG = "metadata.yaml"  # What a folder with a bag of ROS 2 holds.

# What tells an archive of events from one of tracks or of a truth.
EVENT_MEMBERS = ("x.npy", "events.npy")

# What tells an archive of events or of displacements over time.
SERIES_MEMBERS = (*EVENT_MEMBERS, "displacement_px.npy", "displacement_mm.npy")


def is_many(given: Sequence[Path]) -> bool:
    """Return whether more than one recording is meant: several paths, a pattern, or a folder."""
    return len(given) != 1 or _is_pattern(given[0]) or _is_plain_folder(given[0])


def find_recordings(
    given: Sequence[Path], members: Sequence[str] = EVENT_MEMBERS, apart_from: Path | None = None
) -> list[Path]:
    """Return the recordings that files, folders and patterns name, each of them once.

    A folder stands for every recording in it and below; a pattern is what a shell expands, ``**``
    included. A path that is named itself is taken as it is, so that its error is told for it.

    Args:
        given: Paths and patterns.
        members: In a folder, an archive with one of these arrays is meant.
        apart_from: Folder of results: what lies in it is no recording.

    Raises:
        ConfigError: Nothing is given, a folder or pattern holds no recording, or a camera is among
            them.
    """
    if not given:
        raise ConfigError("name a recording, several, a folder of them, or a pattern in quotes")
    # A dictionary keeps the order, and each recording once.
    results = None if apart_from is None else _absolute(apart_from)
    found: dict[Path, None] = {}
    for path in given:
        if str(path) == "-" or is_address(path):
            raise ConfigError(
                f"{str(path)!r} is a live source; many recordings must be files or folders"
            )
        named = sorted(glob.glob(str(path), recursive=True)) if _is_pattern(path) else [path]
        inside = [recording for one in named for recording in _at(Path(one), members)]
        several = [one for one in inside if results not in _absolute(one).parents]
        if inside and not several:
            raise ConfigError(
                f"{str(path)!r} lies in the folder for the results, {str(apart_from)!r}; "
                "give another folder: -o results"
            )
        if not several:
            raise ConfigError(
                f"{str(path)!r} holds no recording; valid are folders with {RECORDING_NAME}, and "
                f"files that end in {', '.join(e for e in READABLE if e not in TABLES)}"
            )
        found |= dict.fromkeys(several)
    return list(found)


def common_parent(recordings: Sequence[Path]) -> Path:
    """Return the folder below which all recordings lie."""
    return Path(os.path.commonpath([_absolute(path).parent for path in recordings]))


def outputs_of(recordings: Sequence[Path], folder: Path, ending: str) -> list[Path]:
    """Return the file of each result: below ``folder`` as the recordings lie below their parent.

    Raises:
        ConfigError: Two recordings would have the same result.
    """
    parent = common_parent(recordings)
    taken: dict[Path, Path] = {}
    for path in map(_absolute, recordings):
        # A folder's dots belong to its name: 2026.05.01 has no ending.
        name = path.name if path.is_dir() else path.stem
        output = folder / path.relative_to(parent).with_name(name + ending)
        if output in taken:
            raise ConfigError(
                f"{str(taken[output])!r} and {str(path)!r} would both be written to "
                f"{str(output)!r}; rename one, or give it a folder of its own"
            )
        taken[output] = path
    return list(taken)


def _absolute(path: Path) -> Path:
    """Return a path from the root, without ``..``; links stay, since their names are the user's."""
    return Path(os.path.abspath(path))


def _at(path: Path, members: Sequence[str]) -> Iterator[Path]:
    """Yield a path, or the recordings of a folder and of those in it, in order of their names."""
    if not _is_plain_folder(path):
        yield path
        return
    for inner in sorted(path.iterdir()):
        if inner.name.startswith("."):
            continue
        if inner.is_dir() or _is_event_file(inner, members):
            yield from _at(inner, members)


def _is_pattern(path: Path) -> bool:
    # The options of an address begin with a question mark.
    return glob.has_magic(str(path)) and not (path.exists() or is_address(path))


def _is_plain_folder(path: Path) -> bool:
    """Return whether a path is a folder that is no recording itself."""
    return path.is_dir() and not any((path / n).is_file() for n in (RECORDING_NAME, BAG))


def _is_event_file(path: Path, members: Sequence[str]) -> bool:
    ending = path.suffix.lower()
    if ending != ".npz":
        return ending in READABLE and ending not in TABLES
    names = members_of(path)
    return names is None or not names.isdisjoint(members)  # damage is told as the failure it is
