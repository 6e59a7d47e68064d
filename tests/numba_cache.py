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
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

import grimp

DIGEST_LENGTH = 16  # Hexadecimal digits of a folder's name: 64 bits.

COMPILER = re.compile("njit|@kernel")  # A file that does not name it defines no kernel.

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
    others = [path.parent for path in root.glob(f"*/{DIGESTS_NAME}") if path.parent.name != name]
    others.sort(key=lambda path: path.stat().st_mtime)
    folder = root / name
    if not folder.is_dir():
        _fill(folder, digests, others[-1] if others else None)
    os.utime(folder)
    for path in others[:-1]:  # on the last one another session may still run
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
    names = {path.relative_to(sources).as_posix(): path for path in sorted(sources.rglob("*.py"))}
    modules = {name[:-3].removesuffix("/__init__").replace("/", "."): name for name in names}
    texts = {one: names[name].read_text(encoding="utf-8") for one, name in modules.items()}
    kernels = {name: one for one, name in modules.items() if COMPILER.search(texts[one])}
    closures = {name: {one, *graph.find_upstream_modules(one)} for name, one in kernels.items()}
    return {name: _digest(texts[one] for one in sorted(all_)) for name, all_ in closures.items()}


def _fill(folder: Path, digests: Mapping[str, str], former: Path | None) -> None:
    """Make a cache folder with what the former one holds of unchanged files; all at once."""
    draft = Path(tempfile.mkdtemp(dir=folder.parent))
    if former is not None:
        known = json.loads((former / DIGESTS_NAME).read_text(encoding="utf-8"))
        changed = {Path(name) for name in known if known[name] != digests.get(name)}
        # Numba names an entry ``folder_HASH/file.name-...``. Files of equal names are dropped
        # together, which costs time, not truth.
        stale = [f"{path.parent.name}_*/{path.stem}.*" for path in changed]
        gone = {entry for pattern in stale for entry in former.glob(pattern)}

        def dropped(place: str, names: list[str]) -> set[str]:
            return {name for name in names if Path(place) / name in gone}

        shutil.copytree(former, draft, ignore=dropped, dirs_exist_ok=True)
    (draft / DIGESTS_NAME).write_text(json.dumps(digests, indent=1), encoding="utf-8")
    try:
        draft.rename(folder)
    except OSError:  # another session was faster
        shutil.rmtree(draft, ignore_errors=True)


def _digest(words: Iterable[str]) -> str:
    return hashlib.sha256("\0".join(words).encode()).hexdigest()
