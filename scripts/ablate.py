"""Take one part out of the default tracker at a time, and write what each is worth.

    python scripts/ablate.py ../shared/data WORK > table.md        # all parts, some ten minutes
    python scripts/ablate.py ../shared/data WORK lag leak          # those with such names

A part is a text of the sources and what takes its place (``results/ablation/parts.toml``). Sensors
are calibrated, and the twin's scenes simulated, once, with the whole package; they are kept in the
folder WORK. Printed are rows of a table: mean errors, px; in brackets markers that were lost; "="
is within 0.5 % of the whole tracker.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PARTS = ROOT / "results" / "ablation" / "parts.toml"
SAME_SHARE = 0.005
PROCESSES = 2
LOSS, NOISE_HZ_PX = 0.3, 1.0  # What "drops" lacks of the events of "mix", and "noise" has more.
RECORDED = "gel, recorded"
DRAWN = ("drops", "noise")  # Cases that change the events of "mix".


def main(data: Path, work: Path, wanted: list[str]) -> None:
    """Print the table."""
    subprocess.run([sys.executable, __file__, "--prepare", data, work], check=True, env=using(ROOT))
    parts = tomllib.loads(PARTS.read_text(encoding="utf-8"))
    names = [name for name in parts if not wanted or any(one in name for one in wanted)]

    def errors(name: str) -> dict[str, list[float]]:
        tree = work / "trees" / name.replace(" ", "-").replace(":", "").replace("%", "")
        shutil.rmtree(tree, ignore_errors=True)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "src", tree / "src", ignore=ignored)
        for file, old, new in parts[name]["changes"] if name else ():
            path = tree / "src" / "spikingtac" / file
            text = path.read_text(encoding="utf-8")
            if text.count(old) != 1:
                raise SystemExit(f"{name}: {old!r} stands {text.count(old)} times in {file}")
            path.write_text(text.replace(old, new), encoding="utf-8")
        command = [sys.executable, __file__, "--measure", data, work]
        ran = subprocess.run(command, check=True, env=using(tree), capture_output=True, text=True)
        return json.loads(ran.stdout)

    whole = errors("")
    print("| left out |", " | ".join(whole), "| kept because |\n|" + "---|" * (len(whole) + 2))
    print(row("nothing", whole, {}, ""))
    with ThreadPoolExecutor(PROCESSES) as pool:
        for name, found in zip(names, pool.map(errors, names), strict=True):
            print(row(name, found, whole, parts[name]["because"]), flush=True)


def using(tree: Path) -> dict[str, str]:
    """Return the environment in which a tree's package is the one that is imported."""
    return os.environ | {"PYTHONPATH": str(tree / "src"), "OMP_NUM_THREADS": "1"}


def row(
    name: str, found: dict[str, list[float]], whole: dict[str, list[float]], because: str
) -> str:
    """Return one row of the table."""
    cells = []
    for case, (*values, lost) in found.items():
        places = 3 if case == RECORDED else 4
        text = " / ".join(f"{value:.{places}f}" for value in values) + f" ({lost})" * (lost > 0)
        near = whole and all(
            abs(value - of_all) <= SAME_SHARE * of_all
            for value, of_all in zip(values, whole[case][:-1], strict=True)
        )
        cells.append("=" if near and not lost else text)
    return f"| {name} | {' | '.join(cells)} | {because} |"


def prepare(data: Path, work: Path) -> None:
    """Calibrate every sensor, and simulate the scenes of the twin."""
    from spikingtac.events import TRUTH
    from spikingtac_paper.trials.trial import calibration_of

    index = {}
    for case, trial in trials().items():
        calibration = calibration_of(trial, work, data)
        calibration.save(work / f"{case}.json")
        events = trial.record(work) if hasattr(trial, "record") else data / trial.events
        truth = events / TRUTH if events.is_dir() else data / trial.reference
        index[case] = [str(events), str(truth)]
    (work / "index.json").write_text(json.dumps(index), encoding="utf-8")


def trials() -> dict:
    """Return the cases by name, as the experiments have them."""
    from spikingtac_paper.real_gels import TRIALS
    from spikingtac_paper.trials.trial import Trial

    known = {trial.case: trial for trial in TRIALS}
    return {
        "mix": known["mix/slides"],
        "gel": known["gel/slides"],
        "presses": known["sim-presses/slides"],
        "slides": Trial(case="slides", scene="finger-slides"),
        "torsion": Trial(case="torsion", scene="finger-torsion"),
        RECORDED: known["real-presses"],
    }


def measure(work: Path) -> None:
    """Print the errors of the package that is imported, as JSON."""
    from spikingtac import Calibration, follow, load_config, make_tracker
    from spikingtac.events import open_events
    from spikingtac.types import EventPacket
    from spikingtac_paper.real_gels import Plateaus, plateau_scores, truth_scores
    from spikingtac_paper.trials.trajectories import GroundTruth, Prediction

    settings, found = load_config("default").tracking, {}
    for case, (path, truth) in json.loads((work / "index.json").read_text()).items():
        whole = EventPacket.concatenate(list(open_events(path)))
        calibration = Calibration.load(work / f"{case}.json")
        for name in (case, *DRAWN) if case == "mix" else (case,):
            events = drawn(whole, name) if name in DRAWN else whole
            frames = follow([events], make_tracker(settings, calibration), settings.rate_hz)
            prediction = Prediction.collect(frames, calibration.reference_px, 1)
            if case == RECORDED:
                scores = plateau_scores(prediction, Plateaus.load(Path(truth)), calibration)
                values = [scores["pressed_mean_px"], scores["released_mean_px"]]
            else:
                scores = truth_scores(prediction, GroundTruth.load(truth), calibration)
                values = [scores["error_mean_px"]]
            found[name] = [*values, int(scores["lost_markers"])]
    print(json.dumps({name: found[name] for name in sorted(found, key=ORDER.index)}))


ORDER = ("mix", "gel", "presses", "slides", "torsion", *DRAWN, RECORDED)


def drawn(events: Any, name: str) -> Any:
    """Return a recording's events with some of them lost, or with noise among them."""
    import numpy as np

    from spikingtac.types import EventPacket

    rng = np.random.default_rng(1)
    if name == "drops":
        return events.select(rng.random(len(events)) >= LOSS)
    width, height = events.size
    span_us = events.t_end_us - events.t_start_us
    count = rng.poisson(NOISE_HZ_PX * width * height * span_us * 1e-6)
    ends = ((0, width), (0, height), (0, 2), (events.t_start_us, events.t_end_us))
    columns = [
        np.append(own, rng.integers(*bounds, count).astype(own.dtype))
        for own, bounds in zip((events.x, events.y, events.p, events.t), ends, strict=True)
    ]
    order = np.argsort(columns[3], kind="stable")
    columns = [column[order] for column in columns]
    return EventPacket(*columns, events.t_start_us, events.t_end_us, events.size)


if __name__ == "__main__":
    how, *rest = sys.argv[1:]
    folders = [Path(one).resolve() for one in (rest if how.startswith("--") else sys.argv[1:])[:2]]
    folders[1].mkdir(parents=True, exist_ok=True)
    if how == "--prepare":
        prepare(*folders)
    elif how == "--measure":
        measure(folders[1])
    else:
        main(*folders, sys.argv[3:])
