"""What a session does not wait for at its start."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.pipeline.checked_source import CheckedSource
from spikingtac.viewer import session as loop
from spikingtac.viewer.opening import calibrated_view, open_view_source
from spikingtac.viewer.session import Session
from stand_ins.viewer import open_circling


def test_the_calibration_of_a_scene_is_its_own_and_any_other_is_compared(tmp_path: Path) -> None:
    view = open_view_source("finger-torsion")
    try:
        assert view.own_calibration
        assert calibrated_view(view, view.calibration, preset="fast", rate_hz=None).own_calibration
        view.calibration.save(tmp_path / "given.json")
        other = Calibration.load(tmp_path / "given.json")
        assert not calibrated_view(view, other, preset="fast", rate_hz=None).own_calibration
    finally:
        view.source.close()  # type: ignore[attr-defined]
    given = open_view_source("finger-torsion", calibration=str(tmp_path / "given.json"))
    given.source.close()  # type: ignore[attr-defined]
    assert not given.own_calibration


@pytest.mark.parametrize("own", [True, False])
def test_only_a_calibration_from_elsewhere_is_compared_with_the_events(
    own: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = []

    def noted(*arguments: object) -> CheckedSource:
        compared.append(arguments)
        return CheckedSource(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(loop, "CheckedSource", noted)
    view = replace(open_circling(20_000), own_calibration=own)
    Session(view, frames=_Nowhere(), greetings=_Nowhere(), repeat=False).close()
    assert bool(compared) != own


class _Nowhere:
    """Takes every message."""

    def publish(self, message: bytes) -> bool:
        return bool(message)
