"""Every figure of speed in one run: beside the peers, and in turns with a former release.

    python -m build --wheel ../before                     # a checkout of the former release
    python benchmarks/speed.py ../shared/data/v2e --former ../before/dist/*.whl -o results/speed

The folder of recordings holds ``bootstrap.raw``, ``quiet.raw``, ``mix.raw`` and ``mix.truth.npz``.
Takes a quarter of an hour on an idle machine; other work makes every time longer, so that the load
is written down, too. ``--only starts skins`` runs some parts anew and keeps the others. The parts
themselves are the programs beside this one, which print more. Writes ``speed.json`` and
``speed.md``. Needs the extra ``[bench]``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from cost import HOUR_S, Run, live_shares, measured, verb_costs
from deadlines import METHODS as PRESETS
from deadlines import latencies_us
from decode import rates_mev_s
from demo_start import start_once
from in_turns import compare
from tracking import DECODE_ROUNDS, PEER, steps_in_turns

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.create import create_events
from spikingtac.events.open import open_events
from spikingtac.markers.calibration.calibrate import calibrate
from spikingtac_paper.harness.run_options import RunOptions
from spikingtac_paper.throughput import skins

DEADLINE_RUNS = (2, 20.0)
"""Paced runs of each method, and seconds of each."""

TURNS = 11
"""Rounds with the former release."""

LAPS = (10, 60)
"""How often ``mix.raw`` is repeated to see whether memory grows."""

WARM_STARTS = 2


@dataclass(frozen=True, slots=True)
class Figure:
    """A measured figure and its aim.

    Attributes:
        part: Part of the run.
        name: What was measured, with its unit.
        value: The figure.
        aim: What is aimed at; None where nothing is.
        most: Whether the aim is the largest value that will do, or the smallest.
    """

    part: str
    name: str
    value: float
    aim: float | None = None
    most: bool = True

    @property
    def met(self) -> str:
        """yes, no, or nothing."""
        if self.aim is None:
            return ""
        return "yes" if (self.value <= self.aim) == self.most or self.value == self.aim else "no"


@dataclass(frozen=True, slots=True)
class Given:
    """What every part is given: recordings, their calibration (file and value), former release."""

    folder: Path
    saved: Path
    calibration: Calibration
    former: Path | None


def starts(given: Given) -> Iterator[Figure]:
    """Time the first and the second start."""
    first = "demo: first picture, s"
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as made:
        yield Figure("starts", f"{first}, first start", start_once(cache, made)["first frame"], 5.0)
        again = [start_once(cache, made)["first frame"] for _ in range(WARM_STARTS)]
        yield Figure("starts", f"{first}, second start", float(np.median(again)), 2.0)
        track_verb(given, given.folder / "mix.raw", Path(made))
        again_s = track_verb(given, given.folder / "mix.raw", Path(made)).wall_s
        yield Figure("starts", "track of ten seconds, s, second start", again_s, 3.0)


def streams(given: Given) -> Iterator[Figure]:
    """Decode and track beside the peers."""
    packets = [packet for packet in open_events(given.folder / "mix.raw") if len(packet)]
    rates = rates_mev_s(packets, DECODE_ROUNDS)
    yield from (Figure("streams", f"{task}, Mev/s", rate) for task, rate in rates.items())
    if "library evt3" in rates:
        times = rates["decode evt3"] / rates["library evt3"]
        yield Figure("streams", "decode evt3, times as fast as the library", times)
    found = steps_in_turns(given.folder, given.calibration, packets)
    peer_us = float(np.median(found[PEER].times_us))
    for name, steps in found.items():
        p50_us, p99_us = np.percentile(steps.times_us, (50, 99))
        aim_us = 1_000.0 if name == "paper" else None
        yield Figure("streams", f"step of {name}, 64 markers, p50, us", float(p50_us))
        yield Figure("streams", f"step of {name}, 64 markers, p99, us", float(p99_us), aim_us)
        yield Figure("streams", f"{name}, times as fast as tuned OpenCV", peer_us / float(p50_us))
        yield Figure("streams", f"{name}, mean error, px", steps.error_px)


def former(given: Given) -> Iterator[Figure]:
    """Take turns with the former release."""
    if given.former is None:
        return
    for task, ratio in compare(given.former, given.folder, None, TURNS).items():
        name = f"{task}, over the former release's ({ratio.low:.2f} to {ratio.high:.2f})"
        yield Figure("former", name, ratio.median, 1.01 if task.startswith("error") else None)


def skins_bench(given: Given) -> Iterator[Figure]:
    """Run the bench of big skins."""
    aims = {
        ("default", "1024@2", "step_p99_us"): (1_000.0, True),
        ("fast", "1024@2", "step_p99_us"): (400.0, True),
        ("default", "1024@50", "absorb_mev_s"): (200.0, False),
        ("fast", "1024@50", "absorb_mev_s"): (200.0, False),
        ("calibrate", "1024 slides", "calibration_s"): (60.0, True),
        ("calibrate", "1024 slides", "peak_mb"): (2_000.0, True),
    }
    with tempfile.TemporaryDirectory() as made:
        output = Path(made, "skins")
        skins.run(RunOptions(output=output))
        rows = json.loads((output / "report.json").read_text(encoding="utf-8"))["rows"]
    for row in rows:
        aim, most = aims.get((row["method"], row["case"], row["metric"]), (None, True))
        name = f"{row['method']}, {row['case']}: {row['metric']}, {row['unit']}"
        yield Figure("skins", name, row["value"], aim, most)


def offline(given: Given) -> Iterator[Figure]:
    """Follow recordings faster than real time, and see whether memory grows with their length."""
    for preset, rate_hz, share in live_shares(given.folder / "mix.raw", given.calibration):
        aim = 6.0 if (preset, rate_hz) == ("default", 1_000.0) else None
        name = f"{preset} at {rate_hz:.0f} Hz, times real time on one core"
        yield Figure("offline", name, 1.0 / share, aim, most=False)
        yield Figure("offline", f"{preset} at {rate_hz:.0f} Hz, CPU s an hour", share * HOUR_S)
    with tempfile.TemporaryDirectory() as made:
        recording = Path(made, "laps.raw")
        peak_mb, length_s = [], []
        for laps in LAPS:
            length_s.append(repeat(given.folder / "mix.raw", recording, laps))
            peak_mb.append(track_verb(given, recording, Path(made)).peak_mb)
    growth = (peak_mb[1] - peak_mb[0]) / (length_s[1] - length_s[0])
    hour_mb = peak_mb[1] + growth * (HOUR_S - length_s[1])
    yield Figure("offline", f"track of {length_s[1]:.0f} s, peak memory, MB", peak_mb[1])
    yield Figure("offline", "track of an hour, MB, from the growth", hour_mb, 300.0)


def deadlines(given: Given) -> Iterator[Figure]:
    """Pace both presets at 1 kHz beside a loaded core."""
    aims_us = {"default": 500.0, "fast": 200.0}
    found = latencies_us(given.calibration, given.folder, PRESETS, DEADLINE_RUNS)
    for (method, way), took_us in found.items():
        name = f"{method} {way} --realtime"
        yield Figure("deadlines", f"{name}, p50, us", float(np.median(took_us)))
        p99_us = float(np.percentile(took_us, 99))
        aim_us, most_missed = (aims_us[method], 0.1) if way == "with" else (None, None)
        yield Figure("deadlines", f"{name}, p99, us", p99_us, aim_us)
        missed = 100.0 * float((took_us > 1_000.0).mean())
        yield Figure("deadlines", f"{name}, missed, %", missed, most_missed)


def memory(given: Given) -> Iterator[Figure]:
    """Measure the largest memory of each verb."""
    with tempfile.TemporaryDirectory() as made:
        for verb, run in verb_costs(given.folder, Path(made, "calibration.json"), Path(made)):
            yield Figure("memory", f"{verb}, peak, MB", run.peak_mb)
            yield Figure("memory", f"{verb}, s", run.wall_s)


PARTS: dict[str, Callable[[Given], Iterator[Figure]]] = {
    "starts": starts,
    "streams": streams,
    "former": former,
    "skins": skins_bench,
    "offline": offline,
    "deadlines": deadlines,
    "memory": memory,
}


def track_verb(given: Given, recording: Path, made: Path) -> Run:
    """Track with the command line and return what it used."""
    command = [sys.executable, "-m", "spikingtac", "track", str(recording), "--overwrite"]
    command += ["--calibration", str(given.saved), "-o", str(made / "tracks.npz")]
    run = measured(command)
    if run.code:
        raise SystemExit(f"{' '.join(command)} ended with {run.code}")
    return run


def repeat(recording: Path, path: Path, laps: int) -> float:
    """Write a recording several times over; return its length, s."""
    packets = list(open_events(recording))
    span_us = packets[-1].t_end_us - packets[0].t_start_us
    path.unlink(missing_ok=True)
    with create_events(path, packets[0].size) as writer:
        for lap in range(laps):
            for one in packets:
                start_us, end_us = one.t_start_us + lap * span_us, one.t_end_us + lap * span_us
                later = replace(one, t=one.t + lap * span_us, t_start_us=start_us, t_end_us=end_us)
                writer.write(later)
    return laps * span_us * 1e-6


def kept_figures(output: Path, anew: list[str]) -> list[Figure]:
    """Return the figures of an earlier run, without the parts that are measured anew."""
    path = output / "speed.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else []
    found = [Figure(**{name: row[name] for name in row if name != "met"}) for row in rows]
    return [figure for figure in found if figure.part not in anew]


def table(figures: list[Figure], loads: tuple[float, float], minutes: float) -> str:
    """Return the figures as Markdown."""
    lines = [
        "# Speed",
        "",
        f"Made by `python benchmarks/speed.py` in {minutes:.0f} minutes on {os.cpu_count()} "
        f"processors; load of the machine before and after {loads[0]:.1f}, {loads[1]:.1f}. "
        "Recordings by v2e, skins by the twin: simulated.",
    ]
    measured_parts = {figure.part for figure in figures}
    for part in [part for part in PARTS if part in measured_parts]:
        lines += ["", f"## {part.capitalize()}", "", "| figure | measured | aim | met |"]
        lines.append("| --- | --- | --- | --- |")
        for one in figures:
            if one.part == part:
                aim = "" if one.aim is None else f"{'≤' if one.most else '≥'} {one.aim:g}"
                lines.append(f"| {one.name} | {one.value:.4g} | {aim} | {one.met} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure, and write both files after each part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="with bootstrap.raw, quiet.raw, mix.raw, truth")
    parser.add_argument("--former", type=Path, help="wheel or checkout of a former release")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    begun_s, before = time.monotonic(), os.getloadavg()[0]
    figures = kept_figures(options.output, options.only)
    with tempfile.TemporaryDirectory() as made:
        saved = Path(made, "calibration.json")
        calibration = calibrate(open_events(options.folder / "bootstrap.raw"))
        calibration.save(saved)
        given = Given(options.folder, saved, calibration, options.former)
        for part in options.only:
            for figure in PARTS[part](given):
                figures.append(figure)
                print(f"{part}: {figure.name}: {figure.value:.4g} {figure.met}", flush=True)
            loads, minutes = (before, os.getloadavg()[0]), (time.monotonic() - begun_s) / 60.0
            rows = json.dumps([asdict(one) | {"met": one.met} for one in figures], indent=1)
            (options.output / "speed.json").write_text(rows + "\n", encoding="utf-8")
            text = table(figures, loads, minutes)
            (options.output / "speed.md").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
