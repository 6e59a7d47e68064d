"""What an import loads, and who may import what."""

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import spikingtac
from stand_ins.source_trees import FILES, SOURCES, tree_of

PROJECT = Path(__file__).resolve().parents[2]
HEAVY = {"numba", "scipy", "matplotlib", "torch", "onnxruntime", "onnx", "h5py", "websockets"}

# Modules of the package that ``--help`` may load. It takes 0.1 s, nearly all of it Python's own
# start; a time would measure what else the machine does, the modules are what it consists of.
OWN_MODULES = 9
ROOMS = sorted(path.parent.name for path in SOURCES.glob("spikingtac/*/__init__.pyi"))


def modules_after(statement: str) -> set[str]:
    """Return the modules that a statement loads in a fresh Python, without those of its start."""
    code = (
        f"import sys; before = set(sys.modules)\n{statement}\n"
        "print('loaded:', *set(sys.modules) - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    return set(done.stdout.rpartition("loaded:")[2].split())


def test_every_public_name_resolves_and_no_other() -> None:
    for name in spikingtac.__all__:
        assert getattr(spikingtac, name) is not None
        assert name in dir(spikingtac)
    with pytest.raises(AttributeError, match="no attribute 'trakc'"):
        _ = spikingtac.trakc


@pytest.mark.parametrize(
    "statement",
    ["import spikingtac", "from spikingtac.cli.main import main; assert main(['--help']) == 0"],
)
def test_import_and_help_load_the_standard_library_and_little_else(statement: str) -> None:
    modules = modules_after(statement)
    own = {name for name in modules if name.startswith("spikingtac")}
    others = {name.split(".")[0] for name in modules - own}
    assert others - sys.stdlib_module_names <= {"lazy_loader"}
    assert 0 < len(own) <= OWN_MODULES, sorted(own)


def test_a_subpackage_alone_loads_nothing_heavy() -> None:
    for package in ("events", "denoise", "markers", "contact", "robot", "sim"):
        assert not modules_after(f"import spikingtac.{package}") & HEAVY, package


def test_viewing_a_recording_loads_nothing_of_the_gel() -> None:
    """A page's two processes import it before they show anything."""
    loaded = modules_after("import spikingtac.viewer.opening")
    assert "spikingtac.viewer.opening" in loaded
    assert not loaded & {"spikingtac.sim.gel", "spikingtac.sim.source", "scipy.fft"}


def test_import_contracts() -> None:
    command = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
    environment = {**os.environ, "NO_COLOR": "1"}
    done = subprocess.run(
        command, cwd=PROJECT, capture_output=True, text=True, timeout=120, env=environment
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


def test_experiments_and_hardware_import_no_deeper_than_a_room() -> None:
    deep = [
        f"{path.relative_to(SOURCES)}: {node.module}"
        for path in FILES
        if path.relative_to(SOURCES).parts[0] != "spikingtac"
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ImportFrom) and re.match(r"spikingtac\.\w+\.", node.module or "")
    ]
    assert deep == []


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_of_a_room_is_there(room: str) -> None:
    module = importlib.import_module(f"spikingtac.{room}")
    named = [getattr(module, name) for name in module.__all__]
    assert named
    assert not any(isinstance(found, ModuleType) for found in named)
