"""A headless browser that reaches nothing but this machine."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.chrome.webdriver import WebDriver
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

PATIENCE_S = 60.0

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
)


@contextmanager
def browser(profile: Path, width: int = 1360, height: int = 900) -> Iterator[webdriver.Chrome]:
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("chromium and chromedriver are not installed")
    options = Options()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    try:
        yield chrome
    finally:
        chrome.quit()


def js(page: WebDriver, expression: str) -> Any:
    """Return the value of an expression of the page's script."""
    return page.execute_script(f"return {expression}")


def wait(page: WebDriver, condition: str, patience_s: float = PATIENCE_S) -> None:
    """Wait until an expression of the page's script is true."""
    WebDriverWait(page, patience_s, 0.05).until(lambda _: js(page, condition), condition)


def found(page: WebDriver, name: str) -> WebElement:
    """Return an element of the page by its name for tests."""
    return page.find_element(By.CSS_SELECTOR, f"[data-testid='{name}']")
