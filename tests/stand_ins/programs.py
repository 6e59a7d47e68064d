"""Programs that lie beside the package, loaded as modules."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

PROJECT = Path(__file__).resolve().parents[2]


def program(path: str) -> ModuleType:
    """Load a program, as ``scripts/site_hooks.py``, without running it."""
    name = Path(path).stem
    specification = importlib.util.spec_from_file_location(name, PROJECT / path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module  # dataclasses look their module up
    specification.loader.exec_module(module)
    return module
