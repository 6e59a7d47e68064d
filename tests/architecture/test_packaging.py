"""What users get: the packages, what they need, and what no tracked file may hold."""

import email.parser
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import grimp
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


# Names of distributions that differ from what they are imported as.
DISTRIBUTIONS = {"PIL": "pillow"}

# Declared, and used without an import statement: what is imported by a name in a string, what
# builds the documentation, onnxscript, through which torch exports, and extras that name others.
BY_NAME_ONLY = {
    "build123d", "dv-processing", "h5py", "mcap", "neuromorphic-drivers", "opencv-python-headless",
    "openmv", "trackpy", "trimesh", "ur-rtde", "zarr", "mkdocs", "mkdocs-material", "onnxscript",
    "spikingtac",
}  # fmt: skip


def imported() -> set[str]:
    """Return the distributions that the package imports, wherever the import stands."""
    packages = PACKAGES.split(",")
    graph = grimp.build_graph(*packages, include_external_packages=True, cache_dir=None)
    names = {name for name in graph.modules if graph.is_module_squashed(name)}
    foreign = names - sys.stdlib_module_names
    return {DISTRIBUTIONS.get(name, name) for name in foreign}


def declared() -> set[str]:
    """Return the distributions that a user may install, those of the extra [dev] left out."""
    project = PROJECT_TABLE["project"]
    extras = project["optional-dependencies"]
    lists = [project["dependencies"], *(extras[name] for name in extras if name != "dev")]
    return {re.split(r"[^A-Za-z0-9._-]", text)[0] for each in lists for text in each}


def test_imports_and_declarations_agree() -> None:
    assert imported() - declared() == set(), "declare it in pyproject.toml"
    assert declared() - imported() - BY_NAME_ONLY == set(), "nothing imports it"


def test_the_licence_of_every_dependency_is_listed_once() -> None:
    script = PROJECT / "scripts" / "licences.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert done.returncode == 0, f"not permissive: {done.stdout}"
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    names = [name for name, _, _ in rows]
    assert len(set(names)) == len(names)
    assert {"numpy", "numba", "pillow", "websockets"} <= set(names)
    assert [name for name, _, licence in rows if licence == "not stated"] == []


# Each pattern is written so that it does not match itself.
INDEX_HOSTS = r"py[p]i\.org|python[h]osted|registry\.npm[j]s|deb\.de[b]ian"
MACHINE_PATHS = r"(?<![\w.])/(?:wor[k]|roo[t]|hom[e]|User[s]|tm[p])/\w"
SECRETS = r"BEGIN [A-Z ]*PRIVATE KE[Y]"
FORBIDDEN = re.compile("|".join((INDEX_HOSTS, MACHINE_PATHS, SECRETS)))


@pytest.fixture(scope="module")
def tracked_files() -> list[Path]:
    command = ["git", "ls-files", "-z"]
    listed = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, timeout=60)
    if listed.returncode != 0:
        pytest.skip("not a git checkout: which files are tracked cannot be known")
    files = (PROJECT / name for name in listed.stdout.split("\0") if name)
    return [path for path in files if path.is_file()]


def test_no_index_host_no_machine_path_no_key(tracked_files: list[Path]) -> None:
    found = []
    for path in tracked_files:
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [f"{path.relative_to(PROJECT)}: {hit.group()}" for hit in FORBIDDEN.finditer(text)]
    assert found == []


def test_tracked_files_are_small(tracked_files: list[Path]) -> None:
    limit = 2 * 1024 * 1024
    assert [str(path) for path in tracked_files if path.stat().st_size > limit] == []
