"""Fits give the same numbers, bit by bit, whatever Numba's cache holds and on any processor.

A process that compiles everything and one that finds everything compiled used to differ by 3e-5 px,
and so did one whose kernels were compiled for the simplest processor.
"""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import hashlib
import numpy as np
from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.markers.graded.corrections import OutputCorrections
from spikingtac.markers.graded.disc_locator import DiscLocator
from spikingtac.markers.graded.motion import FIT_NOW
from spikingtac.markers.neighbours import Neighbourhood
from spikingtac.state_map.binary import paint_binary_discs

rng = np.random.default_rng(3)
across, down = np.meshgrid(np.linspace(30.0, 290.0, 8), np.linspace(30.0, 290.0, 8))
places = np.column_stack([across.ravel(), down.ravel()])
calibration = Calibration(
    reference_px=places, radius_px=np.full(64, 9.0), grid=(8, 8), size=(320, 320), contrast=6.0,
    edge_px=1.2,
)
locator = DiscLocator(calibration)
corrections = OutputCorrections(calibration, Neighbourhood(places), 1.0)
digest = hashlib.sha256()
for shift in range(12):
    discs = paint_binary_discs((320, 320), places + shift * 0.13, np.full(64, 9.2))
    level = rng.random((320, 320), np.float32) * np.float32(0.3) + np.float32(1.6) * discs
    locator.map.values[:] = level
    locator.pending[:] = FIT_NOW
    locator.locate(1_000 * shift, np.zeros(64, np.bool_))
    given_px = corrections.update(1_000 * shift, locator.markers, 2e-3, 1.0, (0.0, 0.0))
    for found in (locator.markers, locator.outline_px, given_px):
        digest.update(found.tobytes())
print(digest.hexdigest())
"""


# What lets a process take this machine for one with the oldest processor of its kind.
SIMPLEST = {
    "NUMBA_CPU_NAME": "generic",
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX2 FMA3",
}


def digest(cache: Path, **processor: str) -> str:
    """Fit discs in a process of its own with this cache, and return the digest of the results."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)} | processor
    command = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout


def test_fits_are_bit_equal_whatever_the_cache_holds_and_on_a_simpler_processor(
    tmp_path: Path,
) -> None:
    stored = Path(os.environ["NUMBA_CACHE_DIR"])  # that of the run: once filled, nothing compiles
    once = digest(stored)
    assert list(stored.rglob("disc_locator.locate_discs_kernel*"))
    assert digest(stored) == once
    assert digest(tmp_path / "own", **SIMPLEST) == once
