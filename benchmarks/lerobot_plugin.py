"""Does LeRobot find the camera plug-in by itself, and does the camera give what the sensor felt?

    python benchmarks/lerobot_plugin.py -o results/lerobot --python LEROBOT_ENV/bin/python

LeRobot has pins of its own, so it is run by the interpreter of another environment, which also
needs NumPy, SciPy and Numba. The plug-in is installed into a folder (without dependencies) that
this interpreter sees; LeRobot's own search imports it, its own configuration parser builds the
settings, and its own factory the camera, which plays a simulated recording. The last image is
compared with the tracks of a tracker alone. The exit code is 1 where anything is missing.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

import spikingtac as st  # noqa: E402
from spikingtac.types import EventPacket  # noqa: E402
from stand_ins.small_twin import calibration, touches  # noqa: E402

RATE_HZ = 500.0

CAMERA = r"""
import json, logging, sys, time
import draccus, importlib.metadata
import numpy as np

def main():
    given = json.load(sys.stdin)
    from lerobot.cameras.configs import CameraConfig
    from lerobot.utils.import_utils import register_third_party_plugins
    before = "spikingtac" in CameraConfig.get_known_choices()
    register_third_party_plugins()
    known = sorted(CameraConfig.get_known_choices())
    config = draccus.decode(CameraConfig, {"type": "spikingtac", **given})
    from lerobot.cameras.utils import make_cameras_from_configs
    camera = make_cameras_from_configs({"touch": config})["touch"]
    camera.connect()
    first = camera.read()
    images, vectors = 1, None
    while True:
        try:
            image = camera.async_read(timeout_ms=2_000)
            vectors = camera.read_displacement()
            images += 1
        except ConnectionError as error:
            ended = str(error)
            break
    last = camera.read_latest(max_age_ms=60_000)
    vectors = camera.read_displacement(max_age_ms=60_000)
    camera.disconnect()
    from lerobot_camera_spikingtac.field_image import field_of
    drawn, _ = field_of(last, config.range_px, config.cell_px)
    print(json.dumps({
        "lerobot": importlib.metadata.version("lerobot"),
        "known_before": before,
        "known_after": "spikingtac" in known,
        "class": type(camera).__module__ + "." + type(camera).__qualname__,
        "type": config.type,
        "image": list(first.shape) + [str(first.dtype)],
        "config_size": [config.width, config.height],
        "images": images,
        "ended": ended.rpartition(": ")[2],
        "connected_after": camera.is_connected,
        "last_px": vectors.tolist(),
        "drawn_px": drawn.tolist(),
    }))

if __name__ == "__main__":
    main()
"""


def prepare(folder: Path) -> tuple[dict[str, object], np.ndarray]:
    """Write a recording and a calibration; return the settings and the last displacements."""
    with st.create_events(folder / "touch.raw", touches().size) as writer:
        writer.write(EventPacket.concatenate(list(touches().packets)))
    calibration().save(folder / "calibration.json")
    sensor = st.Calibration.load(folder / "calibration.json")
    config = st.load_config("fast").with_tracking(rate_hz=RATE_HZ)
    tracker = st.make_tracker(config.tracking, sensor)
    *_, last = st.follow(st.open_events(folder / "touch.raw"), tracker, RATE_HZ)
    settings = {
        "source": str(folder / "touch.raw"),
        "calibration": str(folder / "calibration.json"),
        "rate_hz": RATE_HZ,
    }
    return settings, last.displacement_px


def main() -> int:
    """Install the plug-in beside LeRobot, use it, and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--python", required=True, help="interpreter with lerobot")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settings, expected_px = prepare(folder)
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target"]
        plugin = ROOT / "integrations" / "lerobot_camera_spikingtac"
        subprocess.run([*pip, str(folder / "site"), str(plugin)], check=True)
        script = folder / "camera.py"
        script.write_text(CAMERA, encoding="utf-8")
        paths = os.pathsep.join([str(folder / "site"), str(ROOT / "src")])
        said = subprocess.run(
            [given.python, str(script)],
            input=json.dumps(settings),
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": paths},
        )
    if said.returncode:
        sys.stderr.write(said.stderr)
        return 1
    found = json.loads(said.stdout.splitlines()[-1])
    moved_px, drawn_px = np.array(found.pop("last_px")), np.array(found.pop("drawn_px"))
    found["displacement_difference_px"] = round(float(np.abs(moved_px - expected_px).max()), 6)
    found["image_difference_px"] = round(float(np.abs(drawn_px - expected_px).max()), 4)
    found["source"] = "simulated"
    given.output.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found, indent=1)
    (given.output / "plugin.json").write_text(text + "\n", encoding="utf-8")
    print(text)
    right = found["known_after"] and not found["known_before"] and found["images"] > 10
    near = found["displacement_difference_px"] < 1e-3 and found["image_difference_px"] < 0.07
    return 0 if right and near else 1


if __name__ == "__main__":
    sys.exit(main())
