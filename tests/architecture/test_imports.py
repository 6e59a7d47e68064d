import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
HEAVY = ("numba", "scipy", "matplotlib", "torch", "onnxruntime", "onnx", "h5py", "starlette")
IMPORT_BUDGET_S = 0.3
HELP_BUDGET_S = 0.4
TRIES = 5


def loaded_after(statement: str) -> set[str]:
    code = f"{statement}\nimport sys\nprint(*(name.split('.')[0] for name in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    return set(done.stdout.split())


def fastest_s(code: str) -> float:
    """The least of several runs: the others measure what else the machine was doing."""
    timed = f"import time; start = time.perf_counter(); {code}; print(time.perf_counter() - start)"
    runs = []
    for _ in range(TRIES):
        done = subprocess.run(
            [sys.executable, "-c", timed], capture_output=True, text=True, check=True, timeout=60
        )
        runs.append(float(done.stdout.split()[-1]))
    return min(runs)


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


def test_import_time() -> None:
    assert fastest_s("import spikingtac") < IMPORT_BUDGET_S


def test_help_time() -> None:
    call = "from spikingtac.cli.main import main; main(['--help'])"
    assert fastest_s(call) < HELP_BUDGET_S


@pytest.mark.parametrize("package", ["events", "denoise", "markers", "contact", "robot", "sim"])
def test_a_subpackage_alone_loads_nothing_heavy(package: str) -> None:
    assert not loaded_after(f"import spikingtac.{package}") & set(HEAVY)


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
