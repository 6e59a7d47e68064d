"""The page of a sensor without a calibration, in a real browser: look, calibrate, see markers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.chrome.webdriver import WebDriver
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.events.create import create_events
from spikingtac.viewer.calibrating import SaveTarget
from spikingtac.viewer.opening import open_view_or_events
from spikingtac.viewer.source import ViewSource
from stand_ins.browser import browser
from stand_ins.serving import served
from stand_ins.sliding import GRID, MARKERS, SIZE, packets_of_trips, trip

pytestmark = pytest.mark.waits

ARTEFACTS = Path(__file__).resolve().parents[2] / "artefacts"
PATIENCE_S = 120.0
RATE_HZ = 200.0


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slides") / "slides.raw"
    with create_events(path, SIZE) as writer:
        for packet in packets_of_trips([trip((1, 0)), trip((0, 1))]):
            writer.write(packet)
    return path


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with browser(tmp_path_factory.mktemp("profile"), 1400, 900) as opened:
        yield opened


@contextmanager
def page_of(chrome: WebDriver, **arguments: Any) -> Iterator[WebDriver]:
    """Serve a view and open its page, which nothing of another page has touched."""
    opener: Callable[..., ViewSource] = open_view_or_events
    with served(opener, **arguments) as port:
        chrome.get_log("browser")
        chrome.get(f"http://127.0.0.1:{port}/")
        try:
            yield chrome
        finally:
            chrome.get("about:blank")
            chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def text(page: WebDriver, name: str) -> str:
    return page.find_element(By.CSS_SELECTOR, f"[data-testid='{name}']").text


def shown(page: WebDriver, name: str) -> bool:
    return page.find_element(By.CSS_SELECTOR, f"[data-testid='{name}']").is_displayed()


def wait(page: WebDriver, condition: str) -> None:
    WebDriverWait(page, PATIENCE_S, 0.05).until(
        lambda _: page.execute_script(f"return {condition}"), condition
    )


def keep(page: WebDriver, name: str) -> None:
    ARTEFACTS.mkdir(exist_ok=True)
    page.save_screenshot(str(ARTEFACTS / f"{name}.png"))


def complaints(page: WebDriver) -> list[str]:
    return [entry["message"] for entry in page.get_log("browser")]


def test_a_recording_is_calibrated_with_the_page(
    chrome: WebDriver, slides: Path, tmp_path: Path
) -> None:
    target = tmp_path / "calibration.json"
    saved = SaveTarget(path=target)
    with page_of(chrome, source=str(slides), save=saved, rate_hz=RATE_HZ) as page:
        wait(page, "__m.meta?.guide?.grid && __m.meta.guide.enough > 0")
        keep(page, "guide-recording")
        wait(page, "__m.meta.guide.ready")
        assert f"{MARKERS} of {MARKERS} markers have moved enough" in text(page, "guide-count")
        page.find_element(By.ID, "calibrate").click()
        wait(page, "__m.meta.guide.state !== 'guide'")
        assert "Calibrating" in text(page, "guide-advice")
        wait(page, "__m.meta.guide.state === 'done' && __m.arrows.length > 0")
        assert f"{MARKERS} of {MARKERS}" in text(page, "guide-result")
        assert f"Saved as {target.resolve()}" in text(page, "guide-more")
        assert len(page.execute_script("return __m.arrows")) == MARKERS
        assert shown(page, "course")
        assert shown(page, "trace")
        assert page.execute_script("return __m.hello.grid") == list(GRID)
        keep(page, "calibrated-recording")
        assert complaints(page) == []
    assert Calibration.load(target).grid == GRID
