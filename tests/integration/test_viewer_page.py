"""The page in a real browser, compared with what the server sent and with what is true.

Its layers, legend, sizes and themes are looked at as well.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.chrome.webdriver import WebDriver

from spikingtac.calibration.sensor_calibration import Calibration
from spikingtac.viewer.calibrating import SaveTarget
from spikingtac.viewer.opening import open_view
from stand_ins.browser import browser, found, js, wait
from stand_ins.random_packets import save_events
from stand_ins.serving import served
from stand_ins.sliding import GRID, MARKERS, packets_of_trips, trip
from stand_ins.viewer import open_circling, positions_px, reference_px

pytestmark = pytest.mark.waits

PROJECT = Path(__file__).resolve().parents[2]
ARTEFACTS = PROJECT / "artefacts"
WATCHED_FRAMES = 50
LAYERS = ("arrows", "heat", "mesh", "discs", "truth")
SIZES = ((1400, 900), (1920, 1080), (390, 844))


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with served(open_circling) as number:
        yield number


@pytest.fixture(scope="module")
def page(port: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebDriver]:
    with browser(tmp_path_factory.mktemp("profile")) as chrome:
        chrome.get(f"http://127.0.0.1:{port}/")
        wait(chrome, "__m.frames > 5")
        yield chrome


def set_value(page: WebDriver, name: str, value: object) -> None:
    page.execute_script(
        "arguments[0].value = arguments[1];"
        "for (const kind of ['input', 'change']) arguments[0].dispatchEvent(new Event(kind))",
        found(page, name),
        str(value),
    )


def keep(page: WebDriver, name: str) -> None:
    ARTEFACTS.mkdir(exist_ok=True)
    page.save_screenshot(str(ARTEFACTS / f"{name}.png"))


def themed(page: WebDriver, theme: str) -> None:
    """Switch to a theme; the browser's own preference is the one at first."""
    scheme = "getComputedStyle(document.documentElement).colorScheme"
    while js(page, scheme) != theme:
        found(page, "theme").click()


def paused_at(page: WebDriver, t_us: int) -> None:
    if js(page, "__m.meta.playing"):
        found(page, "play").click()
    wait(page, "!__m.meta.playing")
    set_value(page, "timeline", t_us)
    wait(page, f"Math.abs(__m.meta.t_us - {t_us}) <= 1000 && __m.meta.state === 'OK'")


def arrows(page: WebDriver) -> tuple[int, np.ndarray]:
    """Return the time of the estimate that is drawn, us, and the arrows of its markers."""
    t_us, estimate_us, drawn = js(page, "[__m.meta.t_us, __m.meta.estimate_us, __m.arrows]")
    assert 0 <= t_us - estimate_us < 1e6 / js(page, "__m.hello.rate_hz")
    return estimate_us, np.array(drawn)


def test_it_goes_on_drawing(page: WebDriver) -> None:
    """How fast is the machine's affair: a display draws 60 frames a second. It is printed."""
    before, begun_s = js(page, "__m.frames"), time.perf_counter()
    wait(page, f"__m.frames >= {before + WATCHED_FRAMES}")
    rate = WATCHED_FRAMES / (time.perf_counter() - begun_s)
    late_ms = np.percentile(js(page, "__m.latencies_ms"), (50, 99))
    print(f"{rate:.1f} frames/s, stamp to draw p50 {late_ms[0]:.0f} p99 {late_ms[1]:.0f} ms")
    themed(page, "dark")
    keep(page, "viewer-dark")
    assert late_ms[0] > 0.0


def test_scrubbing_goes_anywhere_and_draws_the_markers_displacements(page: WebDriver) -> None:
    scale = float(found(page, "scale").get_attribute("value") or "nan")
    for at_us in (3_200_000, 400_000, 1_234_000):
        paused_at(page, at_us)
        t_us, drawn = arrows(page)
        moved = positions_px(t_us) - reference_px()
        assert drawn.shape == (64, 4)
        np.testing.assert_allclose(drawn[:, :2], reference_px(), atol=1e-3)
        np.testing.assert_allclose(drawn[:, 2:] - drawn[:, :2], scale * moved, atol=1e-2)
    assert found(page, "clock").text == "1.234 s"
    sample, chosen = js(page, "__m.sample"), int(found(page, "marker").text)
    assert sample["t_us"] == t_us
    np.testing.assert_allclose([sample["dx"], sample["dy"]], moved[chosen], atol=1e-2)


def test_everything_has_a_name_for_screen_readers(page: WebDriver) -> None:
    nameless = js(
        page,
        """[...document.querySelectorAll('button, input, select, canvas:not([aria-hidden])')]
        .filter((item) => !(item.ariaLabel || item.labels?.length || item.textContent.trim()))
        .map((item) => item.outerHTML)""",
    )
    assert nameless == []
    paused_at(page, 1_400_000)  # behind the contact at 0.3 s and the one at 1.3 s
    wait(page, "document.getElementById('sensor').ariaLabel.startsWith('64 markers')")
    lamp = "document.querySelector('[data-testid=contact]').innerText"
    wait(page, f"{lamp}.split(/\\s+/).join(' ') === 'CONTACT since 1.300 s'")


def switch(page: WebDriver, name: str, *, on: bool) -> None:
    if found(page, name).is_selected() != on:
        found(page, name).click()


def test_the_legend_names_what_is_drawn_and_nothing_else(page: WebDriver) -> None:
    for chosen, count in (((), 3), (("discs", "mesh", "truth", "arrows"), 8)):  # one marker is lost
        for name in LAYERS:
            switch(page, name, on=name in chosen)
        wait(page, f"document.getElementById('legend').children.length === {count}")
        said = js(page, "[...document.getElementById('legend').children].map((e) => e.innerText)")
        assert said[:2] == ["became brighter", "became darker"]
    assert {"chosen marker", "marker at rest", "grid", "truth", "lost"} <= set(said)
    assert said[-1].startswith("0")
    assert said[-1].endswith("mm)")


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
    themed(page, theme)
    wait(page, f"innerWidth === {width} && __m.frames > {js(page, '__m.frames')} + 3")
    keep(page, f"page-{width}x{height}-{theme}")
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


def test_the_browser_found_nothing_to_complain_about(page: WebDriver) -> None:
    # Reading the canvas back is this test's own doing.
    said = [entry["message"] for entry in page.get_log("browser")]
    assert [text for text in said if "getImageData" not in text] == []


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slides") / "slides.raw"
    return save_events(path, *packets_of_trips([trip((1, 0)), trip((0, 1))]))


def test_a_recording_is_calibrated_with_the_page(slides: Path, tmp_path: Path) -> None:
    target = tmp_path / "calibration.json"
    given = {"source": str(slides), "save": SaveTarget(path=target), "rate_hz": 200.0}
    with served(open_view, **given) as port, browser(tmp_path / "profile", 1400, 900) as page:
        page.get(f"http://127.0.0.1:{port}/")
        wait(page, "__m.meta?.guide?.grid && __m.meta.guide.enough > 0")
        wait(page, "__m.meta.guide.ready")
        assert (
            f"{MARKERS} of {MARKERS} markers have moved enough" in found(page, "guide-count").text
        )
        keep(page, "guide")
        found(page, "calibrate").click()
        wait(page, "__m.meta.guide.state !== 'guide'")
        assert "Calibrating" in found(page, "guide-advice").text
        wait(page, "__m.meta.guide.state === 'done' && __m.arrows.length > 0", 120.0)
        assert f"{MARKERS} of {MARKERS}" in found(page, "guide-result").text
        assert f"Saved as {target.resolve()}" in found(page, "guide-more").text
        assert len(js(page, "__m.arrows")) == MARKERS
        assert found(page, "course").is_displayed()
        assert found(page, "trace").is_displayed()
        assert js(page, "__m.hello.grid") == list(GRID)
        assert page.get_log("browser") == []
    assert Calibration.load(target).grid == GRID
