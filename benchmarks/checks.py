"""What do the checks on entry cost? Steps with and without them, in turns within one process.

    python benchmarks/checks.py ../shared/data/v2e [--calibration c.json] [-o checks.json]

Two trackers follow the same windows of ``mix.raw``, one with the checks of columns, coordinates and
sizes, one with these checks left out; they take turns at every step, and the first of a step
changes, so that what else the machine does slows both alike. Only the time on the processor counts.
"read" are windows of packets as every reader and camera gives them, which have checked their
columns already; "own" are windows that nobody has checked, as a user's may be. Printed is the ratio
of the median steps with a 95 % interval (bootstrap over steps). The aim is 1.03 for what is read;
the exit code is 1 above it.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "src"))

import spikingtac as st  # noqa: E402
from spikingtac.atomic_files import write_json  # noqa: E402
from spikingtac.types import EventPacket  # noqa: E402

PRESETS = ("default", "fast")
STEP_US = 1_000
AIM = 1.03
RESAMPLES = 500
SOUND, REQUIRE_MAP = EventPacket.sound, EventPacket.require_map


def check(wanted: bool) -> None:
    """Let packets be checked on entry, or trusted as if no check were there."""
    EventPacket.sound = SOUND if wanted else lambda self: self
    EventPacket.require_map = REQUIRE_MAP if wanted else lambda self, shape: None


def unmarked(packet: EventPacket) -> EventPacket:
    """Return a packet that nobody has checked."""
    columns = packet.x, packet.y, packet.p, packet.t
    return EventPacket(*columns, packet.t_start_us, packet.t_end_us, packet.size)


def steps_us(preset: str, calibration: Any, packets: list[list[EventPacket]]) -> np.ndarray:
    """Return ``(2, n)`` what each step took, with and without checks, us on the processor."""
    config = st.load_config(preset).tracking
    trackers = [st.make_tracker(config, calibration) for _ in packets]
    streams = [iter(st.windows(st.PacketSource(each, each[0].size), STEP_US)) for each in packets]
    took_s = np.zeros((2, len(packets[0]) - 2))  # the last windows wait for the next packet
    for step in range(took_s.shape[1]):
        for side in (0, 1) if step % 2 else (1, 0):
            check(side == 0)
            begun_s = time.thread_time()
            window = next(streams[side])
            trackers[side].absorb(window)
            trackers[side].estimate(window.t_end_us)
            took_s[side, step] = time.thread_time() - begun_s
    check(True)
    return 1e6 * took_s


def compared(took_us: np.ndarray) -> dict[str, Any]:
    """Return medians, their ratio and its interval."""
    rng, count = np.random.default_rng(0), took_us.shape[1]
    drawn = [np.median(took_us[:, rng.integers(0, count, count)], axis=1) for _ in range(RESAMPLES)]
    low, high = np.percentile([checked / trusted for checked, trusted in drawn], (2.5, 97.5))
    checked_us, trusted_us = np.median(took_us, axis=1)
    return {
        "checked_us": round(float(checked_us), 2),
        "trusted_us": round(float(trusted_us), 2),
        "ratio": round(float(checked_us / trusted_us), 4),
        "interval": [round(float(low), 4), round(float(high), 4)],
    }


def main() -> int:
    """Compare both presets on both kinds of packets."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path, help="folder with bootstrap.raw and mix.raw")
    parser.add_argument("--calibration", type=Path, help="of these recordings, if it is there")
    parser.add_argument("-o", "--output", type=Path, default=Path("checks.json"))
    parser.add_argument("--steps", type=int, default=3_000)
    args = parser.parse_args()
    if args.calibration:
        calibration = st.Calibration.load(args.calibration)
    else:
        calibration = st.calibrate(st.open_events(args.recordings / "bootstrap.raw"))
    source = st.open_events(args.recordings / "mix.raw")
    read = list(itertools.islice(st.windows(source, STEP_US), args.steps))
    record: dict[str, Any] = {"steps": args.steps, "aim": AIM}
    for preset in PRESETS:
        own = [[unmarked(window) for window in read] for _ in range(2)]
        for kind, packets in (("read", [read, read]), ("own", own)):
            found = compared(steps_us(preset, calibration, packets))
            record[f"{preset}, {kind}"] = found
            print(f"{preset}, {kind}: {found}", flush=True)
    write_json(args.output, record)
    return int(any(record[f"{preset}, read"]["ratio"] > AIM for preset in PRESETS))


if __name__ == "__main__":
    sys.exit(main())
