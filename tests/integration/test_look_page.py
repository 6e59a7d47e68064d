"""The page of a sensor without a calibration, in a real browser: look, calibrate, see markers."""

from __future__ import annotations

import threading
import time
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
from spikingtac.viewer.openers import open_view_or_events
from spikingtac.viewer.source import ViewSource
from stand_ins.browser import browser
from stand_ins.piped_camera import PipedCamera
from stand_ins.serving import served
from stand_ins.sliding import GRID, MARKERS, SIZE, packets_of_trips, trip
from stand_ins.viewer import record_circling

pytestmark = pytest.mark.waits

ARTEFACTS = Path(__file__).resolve().parents[2] / "artefacts"
PATIENCE_S = 120.0
RATE_HZ = 200.0
READINGS = ("rate", "on", "noise", "hot")


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


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_events_figures_and_advice_are_on_the_page(
    width: int, height: int, chrome: WebDriver, tmp_path: Path
) -> None:
    folder = record_circling(tmp_path)
    (folder / "calibration.json").unlink()
    source = str(folder / "events.raw")
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    with page_of(chrome, source=source) as page:
        wait(page, "document.querySelector('[data-testid=reading-noise]')?.innerText")
        texts = {name: text(page, f"reading-{name}") for name in READINGS}
        assert texts["on"].endswith("%")
        assert texts["noise"].endswith("events/s")
        assert texts["hot"].isdecimal()
        assert shown(page, "guide-advice")
        assert "Slide a flat object" in text(page, "guide-advice")
        assert "spikingtac calibrate events.raw" in page.find_element(By.ID, "guide-path").text
        for hidden in ("trace", "discs", "reading-largest", "reading-held", "guide-result"):
            assert not shown(page, hidden)
        keep(page, f"look-first-{width}")
        assert complaints(page) == []


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


def test_a_camera_in_a_pipe_is_calibrated_with_the_page(
    chrome: WebDriver, slides: Path, tmp_path: Path
) -> None:
    data, pipe, target = slides.read_bytes(), tmp_path / "live", tmp_path / "calibration.json"
    camera = PipedCamera(pipe, data, lasting_s=2.4, pieces=400)
    camera.pause_after(0.98)  # a camera that goes on, but says nothing for a while
    saved = SaveTarget(path=target)
    with page_of(chrome, source=str(pipe), save=saved, rate_hz=RATE_HZ) as page:
        wait(page, "__m.meta?.guide?.ready")
        threading.Thread(target=_let_go, args=(camera,), daemon=True).start()
        page.find_element(By.ID, "calibrate").click()
        wait(page, "__m.meta.guide.state === 'done' && __m.arrows.length > 0")
        assert f"Saved as {target.resolve()}" in text(page, "guide-more")
        keep(page, "calibrated-camera")
    camera.join()
    assert Calibration.load(target).grid == GRID


def _let_go(camera: PipedCamera) -> None:
    time.sleep(0.2)
    camera.go_on.set()
