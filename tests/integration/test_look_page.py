"""The page of a recording without a calibration, in a real browser."""

from __future__ import annotations

from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait

from spikingtac.viewer.session.events_only import open_view_or_events
from stand_ins.browser import browser
from stand_ins.serving import served
from stand_ins.viewer import record_circling

ARTEFACTS = Path(__file__).resolve().parents[2] / "artefacts"
PATIENCE_S = 60.0
READINGS = ("rate", "on", "noise", "hot")


@pytest.mark.parametrize(("width", "height"), [(1400, 900), (390, 844)])
def test_events_figures_and_advice_are_on_the_page(width: int, height: int, tmp_path: Path) -> None:
    folder = record_circling(tmp_path)
    (folder / "calibration.json").unlink()
    source = str(folder / "events.raw")
    with (
        served(open_view_or_events, source=source) as port,
        browser(tmp_path / "profile", width, height) as page,
    ):
        page.get(f"http://127.0.0.1:{port}/")
        shown = {name: f"[data-testid='reading-{name}']" for name in READINGS}
        wait = WebDriverWait(page, PATIENCE_S, 0.05)
        wait.until(lambda _: page.find_element(By.CSS_SELECTOR, shown["noise"]).text)
        texts = {n: page.find_element(By.CSS_SELECTOR, css).text for n, css in shown.items()}
        assert texts["on"].endswith("%")
        assert texts["noise"].endswith("events/s")
        assert texts["hot"].isdecimal()
        notice = page.find_element(By.ID, "notice")
        assert notice.is_displayed()
        assert "spikingtac calibrate events.raw" in notice.text
        for hidden in ("trace", "discs", "reading-largest", "reading-held"):
            found = page.find_element(By.CSS_SELECTOR, f"[data-testid='{hidden}']")
            assert not found.is_displayed()
        ARTEFACTS.mkdir(exist_ok=True)
        page.save_screenshot(str(ARTEFACTS / f"look-first-{width}.png"))
        assert [entry["message"] for entry in page.get_log("browser")] == []
