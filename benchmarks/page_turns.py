"""What a picture costs the browser, by a former page and this one in turns.

Run: ``python benchmarks/page_turns.py FORMER_PAGE``, the folder ``viewer/web/page`` of a former version, say from
``git archive TAG src/spikingtac/viewer/web/page | tar x -C /tmp``. Frames of the demo (simulated) are taken once and sent
again from memory, 60 a second, so that neither sensor nor tracker takes part. For each size of the window it prints the
CPU time of all of the browser's processes for one picture, ms, and the pictures per second.
"""  # noqa: E501

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from itertools import cycle
from pathlib import Path

import numpy as np
import uvicorn
from page_rate import COMMAND, LAYERS, SETTLING_S, SIZES, browser_cpu_s, opened
from selenium import webdriver
from starlette.applications import Starlette
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.sync.client import connect

import spikingtac.viewer.web

PAGE = Path(spikingtac.viewer.web.__file__).with_name("page")
TAKEN, RATE_HZ, ON_THE_WAY = 420, 60.0, 2
"""Frames that are sent again; how often; and most that are not acknowledged, as the server does."""
WATCHED_S, PATIENCE_S = 5.0, 60.0


def taken() -> tuple[str, list[bytes]]:
    """Return the greeting and the frames of a demo."""
    process = subprocess.Popen(
        [COMMAND, "demo", "--no-browser", "--port", "0"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    try:
        address = next(line.split()[1] for line in process.stderr if line.startswith("open http"))
        greeting, frames = "", []
        with connect(address.replace("http", "ws") + "socket", max_size=None) as page:
            while len(frames) < TAKEN:
                message = page.recv(PATIENCE_S)
                if isinstance(message, bytes):
                    frames.append(message)
                    page.send('{"ack": 1}')
                elif "starting" not in json.loads(message):
                    greeting = message
        return greeting, frames
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)


def served(folder: Path, greeting: str, frames: list[bytes]) -> int:
    """Serve a page whose frames come from memory; return its port."""

    async def socket(page: WebSocket) -> None:
        await page.accept()
        await page.send_text(greeting)
        room = asyncio.Semaphore(ON_THE_WAY)

        async def acknowledged() -> None:
            with suppress(WebSocketDisconnect):
                while True:
                    if "ack" in json.loads(await page.receive_text()):
                        room.release()

        reading = asyncio.create_task(acknowledged())
        due_s = time.monotonic()
        for frame in cycle(frames):
            due_s = max(due_s + 1 / RATE_HZ, time.monotonic() - 0.1)
            await asyncio.sleep(max(due_s - time.monotonic(), 0.0))
            await asyncio.wait_for(room.acquire(), PATIENCE_S)
            if reading.done():
                return
            await page.send_bytes(frame)

    routes = [
        WebSocketRoute("/socket", socket),
        Mount("/", StaticFiles(directory=folder, html=True)),
    ]
    config = uvicorn.Config(Starlette(routes=routes), port=0, log_level="critical")
    server = uvicorn.Server(config)
    threading.Thread(target=server.run, daemon=True).start()
    while not server.started:
        time.sleep(0.05)
    return server.servers[0].sockets[0].getsockname()[1]


def turn(page: webdriver.Chrome, port: int, size: tuple[int, int]) -> tuple[float, float]:
    """Return CPU ms for a picture with all layers, and pictures per second."""
    width, height = size
    page.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )
    page.get(f"http://127.0.0.1:{port}/")
    until_s = time.monotonic() + PATIENCE_S
    while not page.execute_script("return window.__m && __m.frames > 30"):
        if time.monotonic() > until_s:
            raise TimeoutError("the page draws nothing")
        time.sleep(0.1)
    for layer in LAYERS:
        page.execute_script(
            "const b = document.getElementById(arguments[0]); if (!b.checked) b.click()", layer
        )
    time.sleep(SETTLING_S)
    driver, before = page.service.process.pid, page.execute_script("return __m.frames")
    used_s, begun_s = browser_cpu_s(driver), time.perf_counter()
    time.sleep(WATCHED_S)
    pictures = page.execute_script("return __m.frames") - before
    lasted_s = time.perf_counter() - begun_s
    return 1e3 * (browser_cpu_s(driver) - used_s) / max(pictures, 1), pictures / lasted_s


def main() -> int:
    """Take frames, and let the pages draw them in turns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("former", type=Path, help="folder of a former page")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    greeting, frames = taken()
    ports = {folder: served(folder, greeting, frames) for folder in (given.former, PAGE)}
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as profile:
        page = opened(Path(profile))
        try:
            for size in SIZES:
                rounds = [[turn(page, port, size) for port in ports.values()]
                          for _ in range(given.rounds)]  # fmt: skip
                costs = np.median(np.array(rounds), axis=0)
                for (cpu_ms, rate), name in zip(costs, ("former", "this"), strict=True):
                    print(f"{size[0]}x{size[1]} {name}: {cpu_ms:.1f} ms, {rate:.0f} per s")
        finally:
            page.quit()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
