"""The page of a sensor without a calibration, in a real browser: look, calibrate, see markers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from selenium.webdriver.chrome.webdriver import WebDriver

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.create import create_events
from spikingtac.viewer.calibrating import SaveTarget
from spikingtac.viewer.opening import open_view
from spikingtac.viewer.source import ViewSource
from stand_ins.browser import browser, found, js, wait
from stand_ins.serving import served
from stand_ins.sliding import GRID, MARKERS, SIZE, packets_of_trips, trip

pytestmark = pytest.mark.waits

RATE_HZ = 200.0


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slides") / "slides.raw"
    with create_events(path, SIZE) as writer:
        for packet in packets_of_trips([trip((1, 0)), trip((0, 1))]):
            writer.write(packet)
    return path


def text(page: WebDriver, name: str) -> str:
    return found(page, name).text


def test_a_recording_is_calibrated_with_the_page(slides: Path, tmp_path: Path) -> None:
    target = tmp_path / "calibration.json"
    opener: Callable[..., ViewSource] = open_view
    given = {"source": str(slides), "save": SaveTarget(path=target), "rate_hz": RATE_HZ}
    with served(opener, **given) as port, browser(tmp_path / "profile", 1400, 900) as page:
        page.get(f"http://127.0.0.1:{port}/")
        wait(page, "__m.meta?.guide?.grid && __m.meta.guide.enough > 0")
        wait(page, "__m.meta.guide.ready")
        assert f"{MARKERS} of {MARKERS} markers have moved enough" in text(page, "guide-count")
        page.save_screenshot(str(tmp_path / "guide.png"))
        found(page, "calibrate").click()
        wait(page, "__m.meta.guide.state !== 'guide'")
        assert "Calibrating" in text(page, "guide-advice")
        wait(page, "__m.meta.guide.state === 'done' && __m.arrows.length > 0", 120.0)
        assert f"{MARKERS} of {MARKERS}" in text(page, "guide-result")
        assert f"Saved as {target.resolve()}" in text(page, "guide-more")
        assert len(js(page, "__m.arrows")) == MARKERS
        assert found(page, "course").is_displayed()
        assert found(page, "trace").is_displayed()
        assert js(page, "__m.hello.grid") == list(GRID)
        assert page.get_log("browser") == []
    assert Calibration.load(target).grid == GRID
