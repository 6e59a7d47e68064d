"""Loads of the live runtime: rates, sensors and users at once; every event is accounted for."""

from __future__ import annotations

import json
import os
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import spikingtac as st
from spikingtac_paper.live.board import SIZE, board, free_port, user
from spikingtac_paper.live.recording import PATIENCE_S, Recording, address, lost_by_kernel, verb

MEGA = 1e6

# Markers of the sensor that the load stands for; its events are noise.
GRID, PITCH_PX, RADIUS_PX = (8, 8), 36.0, 7.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Load:
    """What comes in, and who uses it.

    Attributes:
        sensors: Sensors, each with a recorder.
        mev_s: Million events per second of each.
        burst_s: Stretch of every second in which they come, s.
        used: Whether a view, a loop of estimates and a plain user are attached to the first one.
        seconds: Length of the short and of the long form, s.
    """

    sensors: int = 1
    mev_s: float
    burst_s: float = 1.0
    used: bool = False
    seconds: tuple[float, float]


# Name -> load.
LOADS = {
    "10 Mev/s, view + record + loop": Load(mev_s=10.0, used=True, seconds=(5.0, 60.0)),
    "4 sensors x 2 Mev/s": Load(sensors=4, mev_s=2.0, seconds=(5.0, 60.0)),
    "bursts of 50 Mev/s": Load(mev_s=50.0, burst_s=0.04, seconds=(5.0, 60.0)),
    "2 Mev/s, view + record + loop": Load(mev_s=2.0, used=True, seconds=(5.0, 60.0)),
}


def calibration() -> st.Calibration:
    """Return the calibration of the sensor that the load stands for."""
    rows, columns = np.indices(GRID).reshape(2, -1)
    middle = (np.array(SIZE) - 1) / 2
    offset = np.column_stack((columns, rows)) - (np.array(GRID[::-1]) - 1) / 2
    return st.Calibration(
        reference_px=middle + PITCH_PX * offset,
        radius_px=np.full(len(offset), RADIUS_PX),
        grid=GRID,
        size=SIZE,
    )


class _Users:
    """A view, a loop of estimates and a plain user of a shared ring."""

    def __init__(self, name: str, folder: Path, seconds: float) -> None:
        path, pipe = folder / "calibration.json", subprocess.PIPE
        calibration().save(path)
        words = (
            f"view ring:{name} --calibration {path} --preset fast --rate-hz 1000 --headless --json "
            f"--seconds {seconds} --no-browser --port 0"
        )
        self._view = subprocess.Popen(verb(*words.split()), stdout=pipe, stderr=pipe, text=True)
        self._loop = st.live(f"ring:{name}", calibration=path, preset="fast", rate_hz=1000.0)
        self._plain = user(name)
        while self._loop.health.state == "starting":
            time.sleep(0.01)
        self._late_ms = ThreadPoolExecutor(1).submit(self._take)

    def _take(self) -> list[float]:
        """Take every frame until the recorder ends, and return how late each was made, ms."""
        return [frame.behind_ms for frame in self._loop]

    def figures(self) -> dict[str, Any]:
        """Return what the users tell once the recorder has ended."""
        late_ms = self._late_ms.result(PATIENCE_S)
        health, counts = self._loop.health, self._plain.result()
        out, _ = self._view.communicate(timeout=PATIENCE_S)
        shown = json.loads(out) if out.strip() else {"losses": {}}
        p50_ms, p99_ms = np.percentile(late_ms or [np.nan], (50, 99)).tolist()
        return {
            "user_unaccounted": counts["published"] - counts["taken"] - counts["missed"],
            "user_missed": counts["missed"],
            "frames_missed": health.missed,
            "loop_overflows": health.lost.overflows,
            "view_missed": shown["losses"].get("missed", 0),
            "loop_late_p50_ms": p50_ms,
            "loop_late_p99_ms": p99_ms,
        }

    def close(self) -> None:
        """End them, whatever became of the stream."""
        self._loop.close()
        for process in (self._view, self._plain.process):
            process.kill()


def run_load(load: Load, folder: Path, seconds: float) -> dict[str, Any]:
    """Run a load, and return its figures; ``unaccounted`` are events that nobody has counted."""
    ports = [free_port() for _ in range(load.sensors)]
    names = [f"load-{os.getpid()}-{port}" for port in ports]
    with ExitStack() as stack:
        recordings = [
            Recording(folder / name, address(port, name))
            for port, name in zip(ports, names, strict=True)
        ]
        for one in recordings:
            stack.callback(one.process.kill)
        users = _Users(names[0], folder, seconds) if load.used else None
        if users is not None:
            stack.callback(users.close)
        rate_ev_s = load.mev_s * MEGA
        boards = [board(port, rate_ev_s, seconds, burst_s=load.burst_s) for port in ports]
        sent = sum(one.result() for one in boards)
        told = [one.end() for one in recordings]
        figures = {} if users is None else users.figures()
    kept, by_kernel = sum(one["readable"] for one in told), sum(map(lost_by_kernel, told))
    lost = sum(one["lost_events"] for one in told) + by_kernel
    return {
        "sent": sent,
        "kept": kept,
        "lost": lost,
        "unaccounted": sent - kept - lost,
        "lost_by_kernel": by_kernel,
        "peak_mb": max(one["peak_mb"] for one in told),
        **figures,
    }
