"""The baselines run with the best values of their tuning, on scenes that nothing scores."""

import inspect
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from spikingtac import MarkerTracker
from spikingtac.config import load_config
from spikingtac_paper.baselines.ekalibr import EkalibrTracker
from spikingtac_paper.baselines.evetac import STRONG, EvetacTracker
from spikingtac_paper.baselines.neutac import neutac_tracker
from spikingtac_paper.point_tracking.cases import main_trials

RECORD = Path(__file__).resolve().parents[3] / "benchmarks" / "records" / "tune_baselines.json"


def defaults(tracker: Callable[..., MarkerTracker]) -> dict[str, Any]:
    return {name: one.default for name, one in inspect.signature(tracker).parameters.items()}


CONFIGS = {
    "evetac": defaults(EvetacTracker),
    "evetac-strong": defaults(EvetacTracker) | STRONG,
    "evetac-filter": defaults(EvetacTracker),
    "neutac": defaults(neutac_tracker),
    "ekalibr": defaults(EkalibrTracker),
    "paper": asdict(load_config("paper").tracking.blobs),
}


@pytest.fixture(scope="module")
def record() -> dict:
    return json.loads(RECORD.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", CONFIGS)
def test_the_defaults_are_the_best_of_the_record(record: dict, name: str) -> None:
    best = min(record[name], key=lambda point: point["error_mean_px"])
    assert {key: CONFIGS[name][key] for key in best["values"]} == pytest.approx(best["values"])


def test_tuning_and_scoring_share_no_scene_and_no_sensor(record: dict) -> None:
    scored = main_trials(range(0, 5), quick=False)
    assert not {trial.scene for trial in scored} & set(record["about"]["scenes"])
    assert record["about"]["serial"] not in {trial.serial for trial in scored}
