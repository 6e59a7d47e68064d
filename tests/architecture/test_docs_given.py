"""Code of the how-tos that needs a camera, an arm or a model: it runs with stand-ins for them."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import spikingtac as st
from architecture.test_docs import BLOCK, MARK, PAGES, PROJECT
from spikingtac.robot import Watchdog, WatchdogConfig, WatchdogThread
from spikingtac.sim.source import SceneSource
from spikingtac.touch import SkinConfig, fit_force, synthetic_series

# What a block names -> what no test can give it; its names are looked up.
NEEDS = {
    "openmv:": "a camera",
    "st.approach(": "an arm that moves",
    "MineSource": "an installed package",
    "spikingtac_mujoco": "the package of an integration",
}


def blocks() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        if page.parent.name == "how-to":
            for index, code in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
                if not code.startswith(MARK):
                    yield f"{page.relative_to(PROJECT)}[{index}]", code


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder with the files, and the names, that the pages have made before."""
    folder = tmp_path_factory.mktemp("given")
    source = SceneSource(st.load_scene("finger-torsion"), duration_s=0.6)
    own = st.Calibration(
        reference_px=np.asarray(source.reference_px),
        radius_px=np.asarray(source.radius_px),
        grid=(8, 8),
        size=source.size,
        step_on=0.14,
        step_off=0.14,
    )
    skin = synthetic_series(SkinConfig(), own.reference_px, 15.4, frames=70)
    fit_force(skin).save(folder / "force.onnx")
    (folder / "training").mkdir()
    weights = resources.files("spikingtac.denoise") / "weights" / "lean-int8.onnx"
    shutil.copy(str(weights), folder / "training")
    (folder / "day_tracks").mkdir()
    (folder / "day_tracks" / "results.csv").write_text("source,displacement_max_px\na.raw,2.5\n")
    windows = [(window,) for window in st.windows(source, period_us=1_000)]
    rest = np.asarray(own.reference_px)
    frames = [
        st.MarkerFrame(t, rest, rest, rest * 0, np.zeros(len(rest), bool), np.ones(len(rest)))
        for t in range(0, 600_000, 1_000)
    ]
    arm = SimpleNamespace(stop=lambda: None, confirm_stop=lambda: None)
    names = {"Watchdog": Watchdog, "WatchdogConfig": WatchdogConfig, "time": time, "arm": arm}
    names |= {"WatchdogThread": WatchdogThread, "st": st, "calibration": own, "frame": frames[-1]}
    return folder, names | {"quiet_windows": windows[:300], "windows": windows, "frames": frames}


@pytest.mark.parametrize("code", [pytest.param(code, id=name) for name, code in blocks()])
def test_a_block_runs_with_what_its_page_gives(
    code: str, given: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, names = given
    monkeypatch.chdir(folder)
    compiled = compile(code, "documentation", "exec")
    if any(word in code for word in NEEDS):
        for name in {name for name in compiled.co_names if f"st.{name}" in code}:
            assert hasattr(st, name)
        return
    exec(compiled, {"__name__": "documentation", **names})
