"""The page opens another recording of the folder, in a real browser."""

from __future__ import annotations

from pathlib import Path

from selenium.webdriver.common.by import By

from spikingtac.viewer.openers import open_from_shelf
from stand_ins.browser import browser, found, js, wait
from stand_ins.serving import served
from stand_ins.viewer import record_circling


def test_the_page_opens_what_the_folder_holds(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    for name in ("first", "second"):
        (recordings / name).mkdir(parents=True)
        record_circling(recordings / name)
    (recordings / "second" / "calibration.json").unlink()
    damaged = recordings / "third.raw"
    damaged.write_text("no events\n" * 99)
    with (
        served(open_from_shelf, source=str(recordings / "first")) as port,
        browser(tmp_path / "profile") as page,
    ):
        page.get(f"http://127.0.0.1:{port}/")
        wait(page, "__m.frames > 3 && __m.hello.opened === 'first'")
        found(page, "open").click()
        entries = found(page, "shelf-names").find_elements(By.TAG_NAME, "button")
        assert [entry.text for entry in entries] == ["first", "second", "third.raw"]
        assert entries[0].get_attribute("aria-current") == "true"
        entries[2].click()
        wait(page, "__m.meta.notice.includes('third.raw')")
        assert js(page, "__m.hello.opened") == "first"
        page.find_element(By.TAG_NAME, "body").send_keys("o")
        found(page, "shelf-names").find_elements(By.TAG_NAME, "button")[1].click()
        wait(page, "__m.hello.opened === 'second' && __m.hello.reference_px.length === 0")
        assert found(page, "label").text == "second"
        wait(page, "!document.getElementById('guide').hidden")
        assert not found(page, "trace").is_displayed()
