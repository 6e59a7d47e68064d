"""Is a foreign calibration noticed, and the right one never? Simulated recordings.

    python benchmarks/foreign_calibrations.py --keep FOLDER [--serials 1 2 3] [--seeds 0 1]

Every scene on the same skin is simulated on several specimens, whose markers were placed by the
same tolerances, and judged against the calibration of its own and of the next specimen, each
learned from slides. Prints the largest contradiction of every recording, the limit, and how long
after the first motion a foreign one was noticed. What is made is kept, so that a second run, with
other code, judges the same events.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.recording import Recording
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac.markers.calibration_check import CalibrationCheck
from spikingtac.sim.scene import catalog
from spikingtac.sim.scene.render import simulate
from spikingtac.sim.scene.scene import Scene

CALIBRATION_SEED = 1_000
LONGEST_S = 8.0
MOVED_PX = 0.5
"""The motion begins where a marker has gone so far."""

LATE_S = 2.0


class Judged(NamedTuple):
    """One recording against the calibration of its own and of another specimen."""

    own: CalibrationCheck
    foreign: CalibrationCheck
    after_s: float


def on_sensor(name: str, serial: int, camera: str) -> Scene:
    scene = catalog.load(name).with_camera(camera)
    return replace(scene, skin=replace(scene.skin, serial=serial))


def made(scene: Scene, folder: Path, seed: int) -> Path:
    if not folder.is_dir():
        simulate(scene, folder, seed=seed, duration_s=LONGEST_S)
    return folder


def calibration_of(serial: int, camera: str, folder: Path) -> Calibration:
    path = folder / f"{camera}-{serial}.json"
    if not path.is_file():
        scene = on_sensor("bootstrap", serial, camera)
        slides = folder / f"{camera}-{serial}-slides"
        simulate(scene, slides, seed=CALIBRATION_SEED, overwrite=True)
        calibrate(Recording.open(slides).events()).save(path)
    return Calibration.load(path)


def judged(recording: Path, calibration: Calibration) -> tuple[CalibrationCheck, float]:
    """Return the check at its end, and when it became sure, s after the first motion."""
    truth = Recording.open(recording).truth() or {}
    moved_px = np.linalg.norm(truth["marker_px"] - truth["reference_px"], axis=2).max(axis=1)
    begin_us = int(truth["marker_t_us"][np.argmax(moved_px > MOVED_PX)])
    check = CalibrationCheck(calibration)
    for packet in Recording.open(recording).events():
        check.absorb(packet)
        if check.ended:
            return check, (packet.t_end_us - begin_us) / 1e6
    check.finish()
    return check, float("nan")


def scenes() -> list[str]:
    """Return the scenes on the usual skin in which something moves early."""
    skin = catalog.load("finger-slides").skin
    usual = [name for name in catalog.names() if catalog.load(name).skin == skin]
    return [name for name in usual if name not in ("quiet", "fifty-contacts")]


def report(camera: str, serial: int, seed: int, options: argparse.Namespace) -> list[Judged]:
    """Judge every scene on one specimen, print a line for each, and return the judgements."""
    other = options.serials[options.serials.index(serial) - 1]
    known = [calibration_of(one, camera, options.keep) for one in (serial, other)]
    judgements = []
    for name in scenes():
        folder = options.keep / f"{camera}-{serial}-{name}-{seed}"
        recording = made(on_sensor(name, serial, camera), folder, seed)
        (own, _), (foreign, after_s) = (judged(recording, one) for one in known)
        print(
            f"{camera:8} {serial} {seed} {name:16} own {own.contradiction:.3f}  "
            f"foreign {foreign.contradiction:.3f}  limit {foreign.limit:.3f}  after {after_s:5.2f} "
            f"s{'  FALSE ALARM' if own.foreign else ''}{'' if foreign.foreign else '  MISSED'}",
            flush=True,
        )
        judgements.append(Judged(own, foreign, after_s))
    return judgements


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", type=Path, required=True)
    parser.add_argument("--serials", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--cameras", nargs="+", default=["typical", "noisy"])
    options = parser.parse_args()
    options.keep.mkdir(parents=True, exist_ok=True)
    found: list[Judged] = []
    for camera, serial, seed in product(options.cameras, options.serials, options.seeds):
        found += report(camera, serial, seed, options)
    late = sum(one.after_s > LATE_S for one in found)
    print(
        f"{len(found)} recordings: {sum(one.own.foreign for one in found)} false alarms, largest "
        f"own share {max(one.own.contradiction for one in found):.3f}; "
        f"{sum(not one.foreign.foreign for one in found)} foreign calibrations missed, {late} "
        f"noticed later than {LATE_S:.0f} s after the first motion (simulated)"
    )


if __name__ == "__main__":
    main()
