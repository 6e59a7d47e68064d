"""The two figures of the paper's point-tracking experiment, as SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spikingtac_paper.harness.rows import Row
from spikingtac_paper.harness.svg import pyplot, svg_text
from spikingtac_paper.trials.prediction import Prediction

DRAWN_POINTS = 1_200
"""Points of a curve: more than the figure has pixels."""


def key_point_figure(
    records: Sequence[Mapping[str, Any]], folder: Path, methods: Sequence[str]
) -> str:
    """Draw one marker's displacement under repeated contact, one panel per method.

    Args:
        records: Records of one trial.
        folder: Folder of the run, with the predictions.
        methods: Panels, in order; methods without a prediction are left out.
    """
    stored = {record["method"]: folder / record["prediction"] for record in records}
    known = {name: Prediction.load(stored[name]) for name in (*methods, "truth") if name in stored}
    loaded = {name: prediction for name, prediction in known.items() if prediction is not None}
    truth = loaded.get("truth")
    panels = [name for name in methods if name in loaded]
    if truth is None or not panels:
        return ""
    marker = _most_moved(truth)
    figure, axes = pyplot().subplots(
        len(panels), 1, figsize=(8, 1.5 * len(panels) + 0.6), sharex=True, squeeze=False
    )
    for axis, name in zip(axes[:, 0], panels, strict=True):
        _curve(axis, truth, marker, {"color": "#8c959f", "lw": 2.5, "label": "truth"})
        _curve(axis, loaded[name], marker, {"color": "#0969da", "lw": 1.0, "label": name})
        axis.set_ylabel("px")
        axis.legend(loc="upper left", fontsize=8)
        axis.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time, s")
    figure.tight_layout()
    return svg_text(figure)


def deviation_figure(
    rows: Sequence[Row], cases: Sequence[str], methods: Sequence[str], metric: str
) -> str:
    """Draw a metric over the sequences, one line of dots per method, with the seeds' interval.

    Args:
        rows: Rows of the report.
        cases: The sequences, in order.
        methods: Names of the methods.
        metric: Name of the metric.
    """
    figure, axis = pyplot().subplots(figsize=(9, 4))
    places = np.arange(len(cases))
    for number, method in enumerate(methods):
        found = {row.case: row for row in rows if (row.method, row.metric) == (method, metric)}
        values = [found[case].value if case in found else np.nan for case in cases]
        shift = 0.5 * (number - (len(methods) - 1) / 2) / max(len(methods), 1)
        ends = [found[case].ci95 if case in found else None for case in cases]
        spread = [
            (value - end[0], end[1] - value) if end and value is not None else (0.0, 0.0)
            for value, end in zip(values, ends, strict=True)
        ]
        axis.errorbar(places + shift, np.array(values, float), np.array(spread).T, fmt="o",
                      ms=4, lw=1, label=method)  # fmt: skip
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.set_xticks(places, [f"{n}\n{case}" for n, case in enumerate(cases, 1)], fontsize=7)
    axis.set_ylabel(metric.replace("_px", "").replace("_", " ") + ", px (simulated)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.16))
    figure.tight_layout()
    return svg_text(figure)


def _most_moved(truth: Prediction) -> int:
    travel_px = np.linalg.norm(truth.detected_px - truth.reference_px, axis=2)
    return int(travel_px.max(axis=0).argmax())


def _curve(axis: Any, prediction: Prediction, marker: int, style: Mapping[str, Any]) -> None:
    every = max(1, len(prediction.t_us) // DRAWN_POINTS)
    away = prediction.position_px[::every, marker] - prediction.reference_px[marker]
    t_s = prediction.t_us[::every] * 1e-6
    axis.plot(t_s, np.hypot(away[:, 0], away[:, 1]), **style)
