"""The documentation as a site: built without a warning, and without anything from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from spikingtac.events.camera import KINDS
from spikingtac.events.open import READABLE

PROJECT = Path(__file__).resolve().parents[2]
DOCS = PROJECT / "docs"
# What a browser fetches from elsewhere while it shows a page.
LOADED = re.compile(
    r"<(?:script|img|iframe|source|video)\b[^>]*\bsrc=\"?(?P<source>(?:https?:)?//[^\s\">]+)"
    r"|<link\b(?=[^>]*\brel=\"?(?:stylesheet|preconnect|preload|prefetch|icon))[^>]*"
    r"\bhref=\"?(?P<link>(?:https?:)?//[^\s\">]+)"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("material", reason="the extra [docs] is not installed")
    folder = tmp_path_factory.mktemp("site")
    # No proxy answers there: a build that fetches anything fails.
    nowhere = {name: "http://127.0.0.1:9" for name in ("http_proxy", "https_proxy", "all_proxy")}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", folder],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=280,
        env={**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_every_page_is_built(site: Path) -> None:
    pages = {path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")}
    pages = pages - {Path("README.html")} | {Path("index.html")}
    built = {path.relative_to(site) for path in site.rglob("*.html")} - {Path("404.html")}
    assert built == pages
    assert (site / "search" / "search_index.json").is_file()


def test_a_page_fetches_nothing_from_elsewhere(site: Path) -> None:
    fetched = {
        found.group()
        for path in site.rglob("*.html")
        for found in LOADED.finditer(path.read_text(encoding="utf-8"))
    }
    assert fetched == set()
    styles = "".join(path.read_text(encoding="utf-8") for path in site.rglob("*.css"))
    assert re.findall(r"@import|url\(\"?https?:", styles) == []


def test_every_kind_of_camera_and_file_is_listed() -> None:
    page = (DOCS / "how-to" / "connect-a-camera.md").read_text(encoding="utf-8")
    assert [kind for kind in KINDS if f"`{kind}:" not in page] == []
    formats = (DOCS / "reference" / "file-formats.md").read_text(encoding="utf-8")
    assert [ending for ending in READABLE if f"`{ending}`" not in formats] == []
