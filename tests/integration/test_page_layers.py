"""The page as a whole: how it starts, its layers, its legend, its sizes, what it saves."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.chrome.webdriver import WebDriver

from stand_ins.browser import browser, found, js, wait
from stand_ins.serving import served
from stand_ins.viewer import open_circling, positions_px, reference_px

pytestmark = pytest.mark.waits

ARTEFACTS = Path(__file__).resolve().parents[2] / "artefacts"
LAYERS = ("arrows", "heat", "mesh", "discs", "truth")
SIZES = ((1400, 900), (1920, 1080), (390, 844))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with (
        served(open_circling) as port,
        browser(tmp_path_factory.mktemp("profile"), 1400, 900) as chrome,
    ):
        chrome.get(f"http://127.0.0.1:{port}/")
        wait(chrome, "__m.frames > 60")
        yield chrome


def switch(page: WebDriver, name: str, *, on: bool) -> None:
    if found(page, name).is_selected() != on:
        found(page, name).click()


def legend(page: WebDriver) -> list[str]:
    wait(page, "document.getElementById('legend').children.length > 0")
    return js(page, "[...document.getElementById('legend').children].map((e) => e.innerText)")


def paused_at(page: WebDriver, t_us: int) -> None:
    if js(page, "__m.meta.playing"):
        found(page, "play").click()
    wait(page, "!__m.meta.playing")
    page.execute_script(
        "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'));"
        "arguments[0].dispatchEvent(new Event('change'))",
        found(page, "timeline"),
        str(t_us),
    )
    wait(page, f"Math.abs(__m.meta.t_us - {t_us}) <= 1000 && __m.meta.state === 'OK'")


def test_the_legend_names_what_is_drawn_and_nothing_else(page: WebDriver) -> None:
    for name in LAYERS:
        switch(page, name, on=False)
    wait(page, "document.getElementById('legend').children.length === 3")
    assert legend(page) == ["became brighter", "became darker", "chosen marker"]
    switch(page, "discs", on=True)
    switch(page, "mesh", on=True)
    switch(page, "truth", on=True)
    switch(page, "arrows", on=True)  # one marker of the stand-in is lost
    wait(page, "document.getElementById('legend').children.length === 8")
    said = legend(page)
    for expected in ("marker at rest", "grid", "truth", "lost"):
        assert expected in said
    assert said[-1].startswith("0")
    assert said[-1].endswith("mm)")


def test_the_heat_map_shows_how_far_the_skin_moved(page: WebDriver) -> None:
    for name in LAYERS:
        switch(page, name, on=False)
    page.execute_script(
        "const s = arguments[0]; s.value = 'none'; s.dispatchEvent(new Event('change'))",
        found(page, "image"),
    )
    paused_at(page, 1_500_000)
    switch(page, "heat", on=True)
    wait(page, f"__m.frames > {js(page, '__m.frames')} + 2")
    shown = page.execute_script(
        """
        const canvas = arguments[0], zoom = canvas.width / 320;
        return arguments[1].map(([x, y]) =>
          [...canvas.getContext("2d").getImageData((x + 0.5) * zoom, (y + 0.5) * zoom, 1, 1).data]);
        """,
        found(page, "sensor"),
        reference_px().tolist(),
    )
    far = np.hypot(*(positions_px(1_500_000) - reference_px()).T)
    dark = js(page, "getComputedStyle(document.documentElement).colorScheme") == "dark"
    light = np.array(shown)[:, :3].sum(axis=1) * (1 if dark else -1)
    chosen = int(found(page, "marker").text)  # a ring is around it
    assert np.corrcoef(np.delete(light, chosen), np.delete(far, chosen))[0, 1] > 0.9
    page.execute_script(
        "const s = arguments[0]; s.value = 'surface'; s.dispatchEvent(new Event('change'))",
        found(page, "image"),
    )


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_everything_has_its_place(page: WebDriver, width: int, height: int, theme: str) -> None:
    for name in LAYERS:
        switch(page, name, on=True)
    # A window of Chromium is 500 px wide at least; a device is as narrow as it is said to be.
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )
    while js(page, "getComputedStyle(document.documentElement).colorScheme") != theme:
        found(page, "theme").click()
    wait(page, f"innerWidth === {width} && __m.frames > {js(page, '__m.frames')} + 3")
    ARTEFACTS.mkdir(exist_ok=True)
    page.save_screenshot(str(ARTEFACTS / f"page-{width}x{height}-{theme}.png"))
    assert js(page, "document.documentElement.scrollWidth <= innerWidth")
    small = js(
        page,
        """[...document.querySelectorAll('button, select, input, summary')]
        .filter((item) => item.offsetParent !== null)
        .map((item) => [item.id || item.outerHTML, item.getBoundingClientRect()])
        .filter(([, box]) => box.height < 24 || box.width < 24).map(([name]) => name)""",
    )
    assert small == []
    edges = js(
        page,
        """['.frame', '.side'].map((name) => document.querySelector(name).getBoundingClientRect())
        .map((box) => [box.left, box.right])""",
    )
    assert min(edge[0] for edge in edges) <= 16
    assert max(edge[1] for edge in edges) >= js(page, "document.documentElement.clientWidth") - 16
    page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_browser_found_nothing_to_complain_about(page: WebDriver) -> None:
    said = [entry["message"] for entry in page.get_log("browser")]
    assert [text for text in said if "getImageData" not in text] == []


def test_a_force_is_drawn_where_the_skin_is_touched(page: WebDriver) -> None:
    drawn = page.execute_async_script(
        """
        const done = arguments[0], modules = [import('/sensor.js'), import('/felt.js')];
        Promise.all(modules).then(([{ Sensor }, { drawFelt }]) => {
          const canvas = document.createElement('canvas'), sensor = new Sensor(canvas);
          [canvas.width, canvas.height] = __m.hello.size;
          sensor.greet(__m.hello);
          sensor.zoom = 1;
          sensor.ground(0, 0);
          const pixel = (x, y) => [...sensor.context.getImageData(x, y, 1, 1).data].join();
          const before = [pixel(190, 160), pixel(110, 110)];
          drawFelt(sensor, { force_n: [2, 0, 1], place_px: [160, 160], extrapolated: false,
                             outline_px: [[110, 110], [210, 110], [210, 210], [110, 210]] });
          done([before, [pixel(190, 160), pixel(110, 110)]]);
        }).catch((error) => done(String(error)));
        """
    )
    assert isinstance(drawn, list), drawn
    before, after = drawn
    assert before[0] != after[0]  # on the shaft of the arrow
    assert before[1] != after[1]  # on the outline
