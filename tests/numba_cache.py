"""A folder for Numba's cache that no changed kernel outlives.

Numba compiles a function anew when the file that defines it changes. It does not look at the
functions of other files that were compiled into it, so that the callers of a changed kernel, and
their tests, keep the former code. Here the folder's name is a digest of the sources. A new folder
takes over what rests on unchanged files alone, since compiling everything takes minutes.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import grimp

DIGEST_LENGTH = 16  # Hexadecimal digits of a folder's name: 64 bits.

# The present one, and the one before it: another session may still run on the former sources.
KEPT_FOLDERS = 2

COMPILER = "njit"  # A file that does not name it defines no kernel.

DIGESTS_NAME = "digests.json"  # File of a cache folder that says for which sources it was made.


def prepare_cache(root: Path, sources: Path) -> Path:
    """Return the cache folder for the sources as they stand; remove those that are out of date.

    Args:
        root: Folder of all cache folders; made if it does not exist.
        sources: Folder of the packages.
    """
    digests = closure_digests(sources)
    name = _digest(f"{path} {digest}" for path, digest in digests.items())[:DIGEST_LENGTH]
    root.mkdir(parents=True, exist_ok=True)
    others = [path for path in root.iterdir() if (path / DIGESTS_NAME).is_file()]
    others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
    folder = root / name
    if not folder.is_dir():
        _fill(folder, digests, others)
    os.utime(folder)
    for path in [path for path in others if path != folder][KEPT_FOLDERS - 1 :]:
        shutil.rmtree(path, ignore_errors=True)
    return folder


def closure_digests(sources: Path) -> dict[str, str]:
    """Return a digest of each file with kernels, and of all files of the packages that it imports.

    The files that those import count too, and so do imports within functions and for annotations:
    a kernel is compiled for the tuples that it is given.

    Returns:
        Path of the file, the package included -> digest, as hexadecimal digits.
    """
    packages = [path.parent.name for path in sources.glob("*/__init__.py")]
    graph = grimp.build_graph(*packages, cache_dir=None)
    texts: dict[str, str] = {}
    names: dict[str, str] = {}
    for path in sorted(sources.rglob("*.py")):
        parts = path.relative_to(sources).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        texts[module] = path.read_text(encoding="utf-8")
        if COMPILER in texts[module]:
            names[module] = path.relative_to(sources).as_posix()
    closures = {module: {module, *graph.find_upstream_modules(module)} for module in names}
    return {
        name: _digest(texts[one] for one in sorted(closures[module]))
        for module, name in names.items()
    }


def _fill(folder: Path, digests: Mapping[str, str], former: Iterable[Path]) -> None:
    """Make a cache folder with what former ones hold of unchanged files; all at once."""
    draft = Path(tempfile.mkdtemp(dir=folder.parent))
    taken: set[tuple[str, str]] = set()
    for other in former:
        known = json.loads((other / DIGESTS_NAME).read_text(encoding="utf-8"))
        changed = {_cache_key(Path(name)) for name in known if known[name] != digests.get(name)}
        entries = {entry: _entry_key(entry) for entry in other.glob("*/*.nb?")}
        for entry, key in entries.items():
            if key not in changed and key not in taken:
                (draft / entry.parent.name).mkdir(exist_ok=True)
                shutil.copy2(entry, draft / entry.parent.name)
        taken |= {*entries.values()} - changed
    (draft / DIGESTS_NAME).write_text(json.dumps(digests, indent=1), encoding="utf-8")
    try:
        draft.rename(folder)
    except OSError:  # another session was faster
        shutil.rmtree(draft, ignore_errors=True)


def _entry_key(entry: Path) -> tuple[str, str]:
    """Return the key of the file that an entry was compiled from: ``folder_HASH/file.name-...``."""
    return entry.parent.name.rpartition("_")[0], entry.name.split(".")[0]


def _cache_key(source: Path) -> tuple[str, str]:
    """Return what Numba names a file's entries after: its folder's name and its own.

    Files of equal key are dropped together, which costs time, not truth.
    """
    return source.parent.name, source.stem


def _digest(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()
