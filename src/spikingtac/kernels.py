"""How the tracker's kernels are compiled, and where compiled kernels are kept.

Numba keeps compiled kernels beside their files, else in the user's cache, and refuses to compile
where it can write to neither: in a container with another user, say. It reads the environment when
it is first imported.
"""

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any

VARIABLE = "NUMBA_CACHE_DIR"
PACKAGE = Path(__file__).parent
OWN_ONLY = 0o700  # Permissions of the folder: what lies in a kernel cache is executed.


def kernel(**options: Any) -> Any:
    """Return the decorator that compiles a kernel which makes no array.

    Numba so need not count the references to the arrays that it is given, which would take a sixth
    of a step; the option is one that Numba's own library uses.

    Args:
        options: Those of ``numba.njit``; ``forceinline`` compiles a part of kernels into each.
    """
    from numba import njit  # a quarter of a second for which importing the package need not wait

    options |= {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
    return njit(**options)


def provide_kernel_cache() -> None:
    """Name a folder of this user among the temporary ones, if Numba would find no other."""
    if os.environ.get(VARIABLE) or os.access(PACKAGE, os.W_OK):
        return
    chosen = os.environ.get("XDG_CACHE_HOME")
    with suppress(RuntimeError, OSError):  # a user without a home, or with that of another
        if may_hold(Path(chosen) if chosen else Path.home() / ".cache"):
            return
    os.environ[VARIABLE] = str(_own_folder())


def may_hold(folder: Path) -> bool:
    """Return whether a folder can be written, or made."""
    standing = next((path for path in (folder, *folder.parents) if path.exists()), None)
    return standing is not None and os.access(standing, os.W_OK)


def _own_folder() -> Path:
    """Return a temporary folder that nobody else can have written into; the same one each time."""
    import tempfile

    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"spikingtac_kernels_{user}"
    with suppress(OSError):
        folder.mkdir(OWN_ONLY, exist_ok=True)
        found = folder.lstat()
        mine = stat.S_ISDIR(found.st_mode) and stat.S_IMODE(found.st_mode) == OWN_ONLY
        if mine and found.st_uid == user:
            return folder
    return Path(tempfile.mkdtemp(prefix="spikingtac_kernels_"))
