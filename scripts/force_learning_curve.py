"""Draw how well forces are told by the number of presses that were learned from.

Each series is told from the others, of which evenly chosen presses are kept:
``python scripts/force_learning_curve.py FILES... -o force_learning_curve.png``. A press ends where
``segment``, a column of the files, changes.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from spikingtac.touch import fit_force, load_series, r_squared

PRESSES = (15, 30, 60, 120, 180)  # Presses of a series that are learned from.


def main() -> None:
    """Learn, measure and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    series = [load_series(path) for path in options.files]
    segments = [np.load(path, allow_pickle=False)["segment"] for path in options.files]
    rows = []
    for count in PRESSES:
        kept = []
        for one, segment in zip(series, segments, strict=True):
            names = np.unique(segment)
            chosen = names[:: max(1, len(names) // count)][:count]
            kept.append(one.part(np.isin(segment, chosen)))
        scores = []
        for number, left_out in enumerate(series):
            model = fit_force([*kept[:number], *kept[number + 1 :]])
            told = model.estimate(left_out)[0]
            scores.append([r_squared(left_out.wrench[:, k], told[:, k]) for k in range(3)])
        rows.append(np.mean(scores, axis=0))
        print(count * (len(series) - 1), rows[-1].round(3))
    draw(np.array(PRESSES) * (len(series) - 1), np.array(rows), options.output)


def draw(presses: np.ndarray, r2: np.ndarray, output: Path) -> None:
    """Draw R2 of the three forces ``(n, 3)`` over the presses ``(n,)``."""
    figure, axes = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    for k, name in enumerate(("Fx", "Fy", "Fz")):
        axes.plot(presses, r2[:, k], marker="o", label=name)
    axes.set(xscale="log", xticks=presses, xlabel="presses learned from", ylabel="R2, other series")
    axes.set_xticks(presses, [str(one) for one in presses], minor=False)
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(output, dpi=120)


if __name__ == "__main__":
    main()
