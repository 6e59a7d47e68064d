"""Tune the baselines on training scenes, so that none of them is crippled; write the record.

The scenes are the twin's ``train-*`` ones, on other sensors and with other seeds than any scored
trial; both camera presets count. Each method's parameters are searched on a small grid around what
its source prints; the set with the least mean error against truth, lost markers included as they
are, is taken. The chosen values are the defaults of the trackers; a test compares the two.

    python benchmarks/tune_baselines.py FOLDER [METHOD ...]

FOLDER keeps the recordings; the record goes to ``benchmarks/records/tune_baselines.json``.
"""

import itertools
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.config import load_config
from spikingtac.markers.registry import MarkerTracker, make_tracker
from spikingtac_paper.baselines.ekalibr import EkalibrTracker
from spikingtac_paper.baselines.evetac import EvetacTracker
from spikingtac_paper.baselines.neutac import neutac_tracker
from spikingtac_paper.trials.methods import Method, main_methods
from spikingtac_paper.trials.metrics import point_scores
from spikingtac_paper.trials.runner import KEPT_HZ
from spikingtac_paper.trials.trial import Trial, calibration_of

RECORD = Path(__file__).with_name("records") / "tune_baselines.json"
SERIAL, SEED = 101, 1_001  # A sensor and a seed that no experiment uses.

SCENES = ("train-circles", "train-drag", "train-rubs", "train-torsion")
CAMERAS = ("typical", "noisy")
DURATION_S = 3.0

SLICED_HZ = 250.0  # Rate at which a tracker with slices of its own is looked at.

GRIDS: dict[str, dict[str, list[Any]]] = {
    "evetac": {
        "reach_ratio": [1.8, 2.2, 2.6, 3.0],
        "gain": [0.001, 0.002, 0.003],
        "gate": [4, 10],
        "regularizer": [7.5e-5],
    },
    "evetac-filter": {
        "reach_ratio": [2.2],
        "gain": [0.002],
        "gate": [4],
        "regularizer": [7.5e-5],
        "support_us": [5_000, 20_000, 50_000, 100_000],
    },
    "evetac-strong": {
        "reach_ratio": [2.2, 2.6],
        "gain": [0.00003, 0.0001, 0.0003],
        "gate": [4, 10],
        "regularizer": [7.5e-5 / 0.003],
    },
    "paper": {
        "support_us": [0, 2_000, 5_000, 10_000, 20_000, 40_000],
        "threshold": [0.5],
    },
    "neutac": {
        "support_us": [5_000, 10_000, 20_000],
        "decay_us": [3e6, 1e7, 3e7, 1e8],
        "level": [0.5],
    },
    "ekalibr": {
        "window_us": [10_000, 20_000, 40_000],
        "dilate_px": [3, 5],
        "radius_tolerance": [0.2, 0.35],
    },
}


def build(name: str, values: dict[str, Any], calibration: Calibration) -> MarkerTracker:
    """Return a tracker with the values of one point of a grid."""
    if name.startswith("evetac"):
        return EvetacTracker(calibration, **values)
    if name == "ekalibr":
        return EkalibrTracker(calibration, **values)
    published = load_config("paper").tracking
    if name == "paper":
        blobs = replace(published.blobs, **values)
        return make_tracker(replace(published, blobs=blobs), calibration)
    return neutac_tracker(calibration, **values)


def rate_hz(name: str) -> float:
    """Return the method's own rate."""
    if name.startswith("evetac"):
        return SLICED_HZ
    return main_methods()[name].rate_hz


def tuned(name: str, folder: Path, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Return every point of a method's grid with its scores, best first."""
    names = list(GRIDS[name])
    trials = [
        Trial(
            case=f"{camera}/{scene}",
            scene=scene,
            seed=SEED,
            serial=SERIAL,
            camera=camera,
            duration_s=DURATION_S,
        )
        for camera in CAMERAS
        for scene in SCENES
    ]
    loaded = [(calibration_of(trial, folder), *trial.open(folder, None)) for trial in trials]
    loaded = [(calibration, list(events), truth) for calibration, events, truth in loaded]
    points = []
    for chosen in itertools.product(*GRIDS[name].values()):
        values = dict(zip(names, chosen, strict=True))
        method = Method(
            name=name,
            about="",
            tracker=name,
            rate_hz=rate_hz(name),
            build=lambda calibration, v=values: build(name, v, calibration),
        )
        scores = [
            point_scores(method.track(events, calibration, KEPT_HZ), truth)
            for calibration, events, truth in loaded
        ]
        mean = {
            key: round(float(np.mean([score[key] for score in scores])), 4)
            for key in ("error_mean_px", "error_p95_px", "lost_markers")
        }
        points.append({"values": values, **mean})
        tell(f"{name} {values} {mean}")
    return sorted(points, key=lambda point: point["error_mean_px"])


def main() -> None:
    folder, names = Path(sys.argv[1]), sys.argv[2:] or list(GRIDS)
    record = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
    record["about"] = {
        "scenes": list(SCENES),
        "cameras": list(CAMERAS),
        "duration_s": DURATION_S,
        "serial": SERIAL,
        "seed": SEED,
        "figures": "simulated; means over scenes and cameras; best first",
    }
    for name in names:
        record[name] = tuned(name, folder, lambda text: sys.stderr.write(text + "\n"))
        RECORD.parent.mkdir(exist_ok=True)
        RECORD.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
