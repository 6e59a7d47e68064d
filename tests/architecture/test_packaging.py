"""The packages that users get: what they hold, and what an index shows of them."""

from __future__ import annotations

import email.parser
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PROJECT_TABLE = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))
LINK = re.compile(r"\]\(([^)\s]+)\)")
OUR_FILES = re.compile(
    r"https://(?:raw\.githubusercontent\.com/spikingtac/spikingtac/main"
    r"|github\.com/spikingtac/spikingtac/blob/main)/([^)#\s]+)"
)
PACKAGES = "spikingtac,spikingtac_paper,spikingtac_hardware"
WHEEL_LIMIT_MB, SDIST_LIMIT_MB = 2.0, 2.0


def called(*command: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=PROJECT, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Build the sdist, and from the tree the wheel, without a network."""
    for module in ("build", "hatchling", "hatch_fancy_pypi_readme"):
        pytest.importorskip(module, reason="the extra [dev] is not installed")
    folder = tmp_path_factory.mktemp("dist")
    called("build", "--no-isolation", "--sdist", "--wheel", "-o", str(folder), str(PROJECT))
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


def described() -> str:
    """Return the front page as an index shows it."""
    text = (PROJECT / "README.md").read_text(encoding="utf-8")
    hook = PROJECT_TABLE["tool"]["hatch"]["metadata"]["hooks"]["fancy-pypi-readme"]
    for rule in hook["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    return text


def test_no_link_of_the_front_page_is_relative_on_an_index() -> None:
    targets = LINK.findall(described())
    assert len(targets) > 10
    assert [target for target in targets if not target.startswith("https://")] == []
    files = {found for target in targets for found in OUR_FILES.findall(target)}
    assert "docs/images/demo.png" in files
    assert [name for name in sorted(files) if not (PROJECT / name).exists()] == []


def test_pictures_lead_to_the_files_and_not_to_pages_about_them() -> None:
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", described())
    assert pictures
    assert all("raw.githubusercontent.com" in target for target in pictures)


def test_both_packages_pass_the_checks_of_an_index(packages: tuple[Path, Path]) -> None:
    pytest.importorskip("twine", reason="the extra [dev] is not installed")
    said = called("twine", "check", "--strict", *map(str, packages))
    assert said.count("PASSED") == 2


def test_the_wheel_holds_the_package_and_nothing_else(packages: tuple[Path, Path]) -> None:
    pytest.importorskip("check_wheel_contents", reason="the extra [dev] is not installed")
    wheel, _ = packages
    assert "OK" in called("check_wheel_contents", "--toplevel", PACKAGES, str(wheel))
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        metadata = next(name for name in names if name.endswith("METADATA"))
        headers = email.parser.Parser().parsestr(archive.read(metadata).decode())
    assert "spikingtac/py.typed" in names
    assert "spikingtac/denoise/weights/lean-int8.onnx" in names
    assert any(name.startswith("spikingtac/viewer/page/") for name in names)
    assert not [name for name in names if not re.match(r"spikingtac(_paper|_hardware)?[-/]", name)]
    assert wheel.stat().st_size < WHEEL_LIMIT_MB * 1e6
    assert {"Homepage", "Documentation", "Issues", "Changelog"} <= {
        line.split(",")[0] for line in headers.get_all("Project-URL", [])
    }
    assert "](docs/" not in headers.get_payload()


def test_the_sdist_holds_no_data(packages: tuple[Path, Path]) -> None:
    _, sdist = packages
    with tarfile.open(sdist) as archive:
        names = [name.partition("/")[2] for name in archive.getnames()]
    assert {"pyproject.toml", "README.md", "LICENSE", "src/spikingtac/__init__.py"} <= set(names)
    tops = {name.split("/")[0] for name in names}
    assert not tops & {"docs", "results", "hardware", "tests", "benchmarks", "examples"}
    assert sdist.stat().st_size < SDIST_LIMIT_MB * 1e6
