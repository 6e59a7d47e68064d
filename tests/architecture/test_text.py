"""What the tracked text may not contain, and what it must."""

import re
import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]

# Each pattern is written so that it does not match itself.
INDEX_HOSTS = r"py[p]i\.org|python[h]osted|registry\.npm[j]s|deb\.de[b]ian"
MACHINE_PATHS = r"(?<![\w.])/(?:wor[k]|roo[t]|hom[e]|User[s]|tm[p])/\w"
SECRETS = r"BEGIN [A-Z ]*PRIVATE KE[Y]"
FORBIDDEN = re.compile("|".join((INDEX_HOSTS, MACHINE_PATHS, SECRETS)))


def tracked_files() -> list[Path]:
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=PROJECT, capture_output=True, text=True, timeout=60
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout: which files are tracked cannot be known")
    files = (PROJECT / name for name in listed.stdout.split("\0") if name)
    return [path for path in files if path.is_file()]


def test_no_index_host_no_machine_path_no_key() -> None:
    found = []
    for path in tracked_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [f"{path.relative_to(PROJECT)}: {hit.group()}" for hit in FORBIDDEN.finditer(text)]
    assert found == []


@pytest.mark.parametrize(
    "text",
    ["/wor" + "k/data", "https://py" + "pi.org/simple", "(/tm" + "p/x.npz)", "/hom" + "e/ada"],
)
def test_the_pattern_finds_what_it_is_for(text: str) -> None:
    assert FORBIDDEN.search(text)


@pytest.mark.parametrize(
    "text", ["docs/" + "work/plan", "../tm" + "p", "https://example.org/roo" + "t/a"]
)
def test_the_pattern_spares_the_harmless(text: str) -> None:
    assert not FORBIDDEN.search(text)


def test_tracked_files_are_small() -> None:
    limit = 2 * 1024 * 1024
    assert [str(path) for path in tracked_files() if path.stat().st_size > limit] == []
