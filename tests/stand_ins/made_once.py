"""What several files of tests need and takes seconds to make: made once in a run of all processes.

The first process that asks makes it, the others wait and read it from a folder of the run.
"""

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

try:
    import fcntl
except ImportError:  # a system without locks of files: each process makes its own
    fcntl = None

T = TypeVar("T")

# Environment variable with the folder of the run; ``conftest.py`` sets it for all processes.
FOLDER_VARIABLE = "SPIKINGTAC_TESTS_MADE_ONCE"


def made_once(name: str, make: Callable[[], T]) -> T:
    """Return what ``make`` makes, or what another process of this run made under the same name.

    Args:
        name: Name within the run; a file's name without its ending.
        make: Makes a value that can be pickled.
    """
    folder = os.environ.get(FOLDER_VARIABLE)
    if folder is None or fcntl is None:
        return make()
    stored = Path(folder) / f"{name}.pickle"
    with stored.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if stored.exists():
            return pickle.loads(stored.read_bytes())
        value = make()
        stored.write_bytes(pickle.dumps(value))
        return value
