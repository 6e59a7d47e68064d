"""The faults of docs/reference/live-faults.md, in their short forms: every event accounted for."""

import re
from pathlib import Path

import pytest

from spikingtac.errors import DeviceError
from spikingtac_paper.live.faults import FAULTS
from spikingtac_paper.live.loads import Load, run_load

pytestmark = pytest.mark.waits

ROOT = Path(__file__).resolve().parents[2]
NOTHING_LEFT = ("wrong encoding", "folder removed")


@pytest.mark.parametrize("name", list(FAULTS))
def test_a_fault_is_told_and_every_event_accounted_for(name: str, tmp_path: Path) -> None:
    fault, short_s, _ = FAULTS[name]
    try:
        found = fault(tmp_path, short_s)
    except DeviceError as error:
        pytest.skip(str(error))
    assert found.unaccounted == 0, found
    assert found.recovered, found
    assert found.kept > 0 or name in NOTHING_LEFT


def test_every_row_of_the_table_is_tested_and_every_fault_stands_in_it() -> None:
    table = (ROOT / "docs" / "reference" / "live-faults.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w[^|]*?) \|", table, re.MULTILINE)
    assert [row for row in rows if row not in ("fault", "attack")] == list(FAULTS)


def test_sensors_side_by_side_that_fall_silent_early_lose_nothing_unseen(tmp_path: Path) -> None:
    load = Load(sensors=2, mev_s=1.0, burst_s=0.3, used=True, seconds=(1.0, 1.0))
    figures = run_load(load, tmp_path, 1.0)
    assert figures["unaccounted"] == figures["user_unaccounted"] == 0
    assert figures["kept"] > 0
