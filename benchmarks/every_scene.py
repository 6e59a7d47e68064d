"""Simulate, calibrate and track every scene of the twin; errors against truth (simulated).

    python benchmarks/every_scene.py [--camera typical] [--preset default] [--seed 1]
        [--design paper-size] [SCENE ...]

A sensor is calibrated once, from slides on it. ``after`` is the error at the end of the scene,
``true`` what the gel itself still holds there.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.errors import SpikingTacError
from spikingtac.events.recording import Recording
from spikingtac.markers.calibration.calibrate import CalibrationConfig, calibrate
from spikingtac.markers.registry import make_tracker
from spikingtac.pipeline.follow import follow
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.render import simulate
from spikingtac.sim.scene.scene import Scene
from spikingtac_hardware.parameters.design import load_design
from spikingtac_hardware.twin import scene_with_design

RATE_HZ = 1_000.0
CALIBRATION_SEED = 1_000
LONGEST_S = 12.0


def slides_for(scene: Scene) -> Scene:
    """Return the bootstrap scene on the sensor of another scene."""
    slides = catalog.load("bootstrap")
    return replace(slides, skin=scene.skin, optics=scene.optics, camera=scene.camera)


def calibrated(scene: Scene, folder: Path) -> Calibration:
    simulate(slides_for(scene), folder, seed=CALIBRATION_SEED, overwrite=True)
    dark = scene.camera.settings.get("light", {}).get("contrast", 6.0) < 1.0
    config = CalibrationConfig(polarity="dark" if dark else "white")
    return calibrate(Recording.open(folder).events(), config)


def errors(folder: Path, preset: str, calibration: Calibration) -> str:
    recording = Recording.open(folder)
    truth = recording.truth() or {}
    tracker = make_tracker(load_config(preset).tracking, calibration)
    frames = list(follow(recording.events(), tracker, RATE_HZ))
    t_us = np.array([frame.t_us for frame in frames])
    found_px = np.array([frame.detected_px for frame in frames])
    held = np.array([frame.coasted for frame in frames])
    at, known_px = truth["marker_t_us"], truth["marker_px"].astype(float)
    after = np.clip(np.searchsorted(at, t_us), 1, len(at) - 1)
    share = np.clip((t_us - at[after - 1]) / (at[after] - at[after - 1]), 0, 1)[:, None, None]
    true_px = known_px[after - 1] * (1 - share) + known_px[after] * share
    error_px = np.linalg.norm(found_px - true_px, axis=2)
    moved_px = np.linalg.norm(true_px - truth["reference_px"], axis=2)
    lost = int((error_px[-1] > 5.0).sum())
    return (
        f"mean {error_px.mean():.3f}  p95 {np.percentile(error_px, 95):.3f}  "
        f"after {error_px[-1].mean():.3f}  true {moved_px[-1].mean():.3f}  "
        f"largest motion {moved_px.max():5.1f} px  held {held.mean():.2%}  lost {lost}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*")
    parser.add_argument("--camera", default="typical")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--design", help="put the scenes on the sensor of a design")
    options = parser.parse_args()
    sensors: dict[str, Calibration] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene_name in options.scenes or catalog.names():
            scene = catalog.load(scene_name).with_camera(options.camera)
            if options.design:
                scene = scene_with_design(scene, load_design(options.design))
            sensor = repr((scene.skin, scene.optics, scene.camera))
            try:
                if sensor not in sensors:
                    sensors[sensor] = calibrated(scene, folder / "slides")
                duration_s = LONGEST_S if scene_name == "fifty-contacts" else None
                simulate(
                    scene,
                    folder / "scene",
                    seed=options.seed,
                    duration_s=duration_s,
                    overwrite=True,
                )
                line = errors(folder / "scene", options.preset, sensors[sensor])
            except SpikingTacError as error:
                line = f"{type(error).__name__}: {error}"
            print(f"{scene_name:16} {line}", flush=True)


if __name__ == "__main__":
    main()
