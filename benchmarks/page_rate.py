"""How fast the page draws with all of its layers, in a real browser beside the demo.

Run: ``python benchmarks/page_rate.py -o page.png``; it needs chromium and chromedriver, and the
extra ``[dev]``. For each size of the window it prints the pictures per second, how long the page's
own script takes for one (median and 99th percentile, ms), and what one costs all of the browser's
processes in CPU time, ms. On a machine without a graphics processor the browser paints with the
processor that the sensor and the tracker need, too: the load is printed beside.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

COMMAND = Path(sys.executable).with_name("spikingtac")
SIZES = ((1400, 900), (1920, 1080), (390, 844))
LAYERS = ("arrows", "heat", "mesh", "discs", "truth")
SETTLING_S, WATCHED_S, PATIENCE_S = 3.0, 10.0, 300.0
WARM_UP_S = 10.0
"""The browser compiles the page's script while it runs: the first seconds draw a picture less."""
PICTURED_US = 6_000_000
"""Moment of the demo that the picture shows, us."""
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run")


def opened(profile: Path) -> webdriver.Chrome:
    """Return a browser that shows nothing on a screen."""
    options = Options()
    options.binary_location = shutil.which("chromium") or "chromium"
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    return webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))


def browser_cpu_s(pid: int) -> float:
    """Return the CPU time of a process and all that it has started, s."""
    stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    children = [
        int(child)
        for task in Path(f"/proc/{pid}/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    own_s = (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")
    return own_s + sum(map(browser_cpu_s, children))


def measured(page: webdriver.Chrome, size: tuple[int, int]) -> dict[str, Any]:
    """Return the figures of one size of the window."""
    width, height = size
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )
    time.sleep(SETTLING_S)
    page.execute_script("__m.draw_ms.length = 0")
    driver = page.service.process.pid
    before, begun_s = page.execute_script("return __m.frames"), time.perf_counter()
    used_s = browser_cpu_s(driver)
    time.sleep(WATCHED_S)
    used_s = browser_cpu_s(driver) - used_s
    frames, draw_ms = page.execute_script("return [__m.frames, __m.draw_ms]")
    lasted_s = time.perf_counter() - begun_s
    p50, p99 = np.percentile(draw_ms, (50, 99))
    return {
        "size": f"{width}x{height}",
        "pictures_per_s": round((frames - before) / lasted_s, 1),
        "browser_cpu_ms": round(1e3 * used_s / max(frames - before, 1), 1),
        "script_p50_ms": round(float(p50), 2),
        "script_p99_ms": round(float(p99), 2),
    }


def pictured(page: webdriver.Chrome, picture: Path) -> None:
    """Write a picture of the page as it looks after some contacts.

    It is paused there: how fast it plays beside other programs is no matter of the picture.
    """
    page.set_window_size(1400, 1040)
    page.execute_script(
        "document.documentElement.dataset.theme = 'light'; document.getElementById('theme').click()"
    )
    until_s = time.monotonic() + PATIENCE_S
    while page.execute_script("return __m.meta.t_us") < PICTURED_US and time.monotonic() < until_s:
        time.sleep(0.02)
    page.execute_script("document.getElementById('play').click()")
    time.sleep(SETTLING_S)
    page.save_screenshot(str(picture))
    page.execute_script("document.getElementById('play').click()")


def watch(address: str, picture: Path | None) -> list[dict[str, Any]]:
    """Show the page with all layers, and measure each size."""
    with tempfile.TemporaryDirectory() as profile:
        page = opened(Path(profile))
        try:
            page.get(address)
            until_s = time.monotonic() + PATIENCE_S
            while page.execute_script("return __m.frames") < 100:
                if time.monotonic() > until_s:
                    raise TimeoutError("the page draws nothing")
                time.sleep(0.2)
            if picture is not None:
                pictured(page, picture)
            for layer in LAYERS:
                page.execute_script(
                    "const b = document.getElementById(arguments[0]); if (!b.checked) b.click()",
                    layer,
                )
            time.sleep(WARM_UP_S)
            return [measured(page, size) for size in SIZES]
        finally:
            page.quit()


def main() -> int:
    """Start the demo, watch it, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--picture", type=Path, help="picture of the page to write")
    given = parser.parse_args()
    process = subprocess.Popen(
        [COMMAND, "demo", "--no-browser", "--port", "0"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        line = next(line for line in process.stderr if line.startswith("open http"))
        found = watch(line.split()[1], given.picture)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    print(json.dumps({"cores": cores, "load": load, "pages": found}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
