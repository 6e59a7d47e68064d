"""What a file of this package holds, for the verb info, and for errors where another was needed."""

import hashlib
import json
import struct
import zipfile
import zlib
from pathlib import Path
from tokenize import TokenError
from typing import Any

# Kind -> members that its archive has.
ARCHIVES = {
    "tracks": {"t_us.npy", "reference_px.npy", "detected_px.npy"},
    "truth": {"marker_t_us.npy", "marker_px.npy"},
    "series": {"t_us.npy", "reference_mm.npy", "displacement_mm.npy"},
}

# Kind -> keys that its JSON has.
DOCUMENTS = {
    "calibration": {"schema", "grid", "reference_px"},
    "force": {"schema", "components", "reference"},
    "report": {"experiment", "rows"},
    "manifest": {"t_start_us", "t_end_us", "size"},
}
RECORDING_NAME = "events.raw"  # What a recording folder has.

# How tables of tracks begin, as CSV and as Parquet; and lists of touches, of distances, of results.
TABLES, LISTS = (b"t_us,marker,", b"PAR1"), (b"begin_us,end_us,", b"marker,", b"source,output,")

# What zipfile and NumPy's header parser raise on damaged archives.
ARCHIVE_DAMAGE = (
    OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error, NotImplementedError,
    SyntaxError, TokenError, RuntimeError, MemoryError, OverflowError, TypeError,
    KeyError, struct.error,
)  # fmt: skip

LONGEST_HEAD = 64  # Bytes of a table that are looked at.
LARGEST_BYTES = 16 << 20  # Larger JSON files are not looked into.

# Kind -> what it is and what reads it.
TOLD = {
    "tracks": "it holds tracks, which spikingtac info, plot and compare read",
    "table": "it is a table; tracks are read as .npz, events as .csv or .npz",
    "list": "it is a list of touches, distances or results, for other programs",
    "truth": "it holds the truth of a simulation, which spikingtac compare reads",
    "series": "it holds displacements of another sensor, which spikingtac touch and force read",
    "calibration": "it is a calibration: give it with --calibration, or to spikingtac info",
    "force": "it is a force model: give it with --force to spikingtac track, view and force",
    "report": "it is the report of an experiment; report.html beside it shows it",
    "manifest": "it is the manifest of a recording: give its folder to spikingtac info",
    "recording": "it is a recording, which spikingtac info, view and track read",
}


def kind_of(path: str | Path) -> str | None:
    """Return a key of :data:`TOLD`, or None for anything else."""
    file = Path(path)
    if file.is_dir():
        return "recording" if (file / RECORDING_NAME).is_file() else None
    if not file.is_file():
        return None
    ending = file.suffix.lower()
    if ending == ".onnx":
        return "force"
    if ending in (".csv", ".parquet"):
        with file.open("rb") as opened:
            head = opened.readline(LONGEST_HEAD)
        return "table" if head.startswith(TABLES) else "list" if head.startswith(LISTS) else None
    if zipfile.is_zipfile(file):
        return _first(ARCHIVES, members_of(file) or ())
    return _first(DOCUMENTS, document_of(file).keys()) if ending == ".json" else None


def told_kind(path: str | Path) -> str | None:
    """Return what a file is, in words for an error, or None where it is nothing of ours."""
    kind = kind_of(path)
    return None if kind is None else TOLD[kind]


def digest_of(file: Path) -> str | None:
    """Return the sha256 of a file's content; None of what is no file, as a folder or a pipe."""
    if not file.is_file():
        return None
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def document_of(file: Path) -> dict[str, Any]:
    """Return the JSON object of a file; an empty one where it holds none."""
    try:
        small = file.stat().st_size <= LARGEST_BYTES
        document = json.loads(file.read_text(encoding="utf-8")) if small else None
    except (OSError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}


def members_of(file: Path) -> set[str] | None:
    """Return the names of an archive's members; None where it is damaged."""
    try:
        with zipfile.ZipFile(file) as archive:
            return set(archive.namelist())
    except ARCHIVE_DAMAGE:
        return None


def _first(kinds: dict[str, set[str]], names: Any) -> str | None:
    return next((kind for kind, needed in kinds.items() if needed <= set(names)), None)
