"""What the package imports is declared, and what is declared is used."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import pytest

from stand_ins.source_trees import FILES, tree_of

PROJECT = Path(__file__).resolve().parents[2]
OWN = ("spikingtac", "spikingtac_paper", "spikingtac_hardware")

# Names of distributions that differ from what they are imported as.
DISTRIBUTIONS = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "rtde_control": "ur-rtde",
    "rtde_receive": "ur-rtde",
}

# Declared, and used without an import statement.
BY_NAME_ONLY = {
    "build123d": "imported by a name in a string",
    "mkdocs": "builds the documentation",
    "mkdocs-material": "builds the documentation",
    "dv-processing": "imported by a name in a string",
    "neuromorphic-drivers": "imported by a name in a string",
    "openmv": "imported by a name in a string",
    "onnxscript": "torch exports networks through it",
    "spikingtac": "extras that name other extras",
    "trimesh": "imported by a name in a string",
}


def imported() -> set[str]:
    """Return the distributions that the package imports, wherever the import stands."""
    names: set[str] = set()
    for path in FILES:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                names.add(node.module.split(".")[0])
    own = (
        names
        - set(sys.stdlib_module_names)
        - {"spikingtac", "spikingtac_paper", "spikingtac_hardware"}
    )
    return {DISTRIBUTIONS.get(name, name) for name in own}


def declared() -> set[str]:
    """Return the distributions that a user may install, those of the extra [dev] left out."""
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lists = [project["dependencies"], *(extras[name] for name in extras if name != "dev")]
    return {re.split(r"[^A-Za-z0-9._-]", text)[0] for each in lists for text in each}


def test_imports_and_declarations_agree() -> None:
    assert imported() - declared() == set(), "declare it in pyproject.toml"
    assert declared() - imported() - set(BY_NAME_ONLY) == set(), "nothing imports it"


def test_the_licence_of_every_dependency_is_listed_once() -> None:
    try:
        distribution("spikingtac")
    except PackageNotFoundError:
        pytest.skip("the package is not installed, so that nothing tells what it needs")
    script = PROJECT / "scripts" / "licences.py"
    done = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert done.returncode == 0, f"not permissive: {done.stdout}"
    rows = [line.split("\t") for line in done.stdout.splitlines()]
    names = [name for name, _, _ in rows]
    assert len(set(names)) == len(names)
    assert {"numpy", "numba", "pillow", "websockets"} <= set(names)
    assert [name for name, _, licence in rows if licence == "not stated"] == []


def test_what_others_broke_has_an_upper_bound() -> None:
    text = (PROJECT / "pyproject.toml").read_text(encoding="utf-8")
    for name in ("numpy", "websockets"):
        assert re.search(rf'"{name}>=[0-9.]+,<[0-9]+"', text), name
