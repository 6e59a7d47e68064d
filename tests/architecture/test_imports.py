import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
HEAVY = ("numba", "scipy", "matplotlib", "torch", "onnxruntime", "onnx", "h5py", "websockets")

# Modules of the package that ``--help`` may load. It takes 0.1 s, nearly all of it Python's own
# start; a time would measure what else the machine does, the modules are what it consists of.
OWN_MODULES = 9


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


def loaded_after(statement: str) -> set[str]:
    """The same, without what is below the packages."""
    return {name.split(".")[0] for name in modules_after(statement)}


def test_importing_the_package_loads_nothing_heavy() -> None:
    loaded = loaded_after("import spikingtac")
    assert "spikingtac" in loaded
    assert not loaded & {*HEAVY, "numpy"}


def test_every_public_name_resolves() -> None:
    import spikingtac

    for name in spikingtac.__all__:
        assert getattr(spikingtac, name) is not None
        assert name in dir(spikingtac)


def test_an_unknown_name_is_an_attribute_error() -> None:
    import spikingtac

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
    packages = ("events", "denoise", "markers", "contact", "robot", "sim")
    loaded = {name: loaded_after(f"import spikingtac.{name}") & set(HEAVY) for name in packages}
    assert {name: heavy for name, heavy in loaded.items() if heavy} == {}


def test_viewing_a_recording_loads_nothing_of_the_gel() -> None:
    """A page's two processes import it before they show anything."""
    loaded = modules_after("import spikingtac.viewer.opening")
    assert "spikingtac.viewer.opening" in loaded
    assert not loaded & {"spikingtac.sim.gel", "spikingtac.sim.source", "scipy.fft"}


def test_import_contracts() -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "NO_COLOR": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout
