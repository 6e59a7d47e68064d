"""What lies beside the package (benchmarks, integrations, scripts) still finds what it imports.

No test runs these programs whole, and pyright reads only ``src``: a module that has moved would
be noticed by the first person who runs one.
"""

import ast
import importlib
import re
import sys
import tomllib
from pathlib import Path

import pytest

import spikingtac
from stand_ins.programs import program

PROJECT = Path(__file__).resolve().parents[2]
PROGRAMS = sorted(
    path
    for folder in ("benchmarks", "examples", "integrations", "scripts")
    for path in (PROJECT / folder).rglob("*.py")
)
OWN = ("spikingtac", "stand_ins")


def missing(node: ast.ImportFrom) -> list[str]:
    """Return what an import names in vain; skip the test if a library of an extra is absent."""
    absent = []
    for name in ("", *(f".{alias.name}" for alias in node.names)):
        try:
            importlib.import_module(f"{node.module}{name}")
        except ModuleNotFoundError as error:
            if error.name is not None and error.name.split(".")[0] not in OWN:
                pytest.skip(f"{node.module} needs {error.name}")
            module = sys.modules.get(node.module or "")
            absent += [] if hasattr(module, name[1:] or "__name__") else [f"{node.module}{name}"]
    return absent


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_a_program_imports_only_what_exists(path: Path) -> None:
    found = [
        node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OWN
    ]
    assert [name for node in found for name in missing(node)] == []


EXAMPLES = [path for path in PROGRAMS if path.parent.name == "examples"]
MOST_LINES = 80


def test_the_examples_go_from_01_to_11() -> None:
    assert [path.name[:3] for path in EXAMPLES] == [f"{number:02}_" for number in range(1, 12)]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_uses_public_names_only(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MOST_LINES
    assert f"Run: python examples/{path.name}" in (ast.get_docstring(ast.parse(text)) or "")
    assert not re.search(r"^\s*from spikingtac|^\s*import spikingtac\.", text, re.M)
    used = set(re.findall(r"\bst\.(\w+)", text))
    assert used
    assert used <= set(spikingtac.__all__)


def test_an_attack_on_guards_without_an_arm_names_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="ur-rtde is missing"):
        program("benchmarks/attack.py").guard(None)


def test_every_mutation_applies_at_one_place_and_names_tests_that_exist() -> None:
    script = program("benchmarks/mutations.py")
    assert len({mutation.name for mutation in script.MUTATIONS}) == len(script.MUTATIONS)
    stale = [one.name for one in script.MUTATIONS if len(script.places(one)) != 1]
    assert stale == [], "the sources have changed: give each the text that stands there now"
    assert [one.name for one in script.MUTATIONS if one.old == one.new] == []
    named = {path for one in script.MUTATIONS for path in one.tests}
    assert [path for path in named if not (PROJECT / path).exists()] == []


def test_every_part_of_the_ablation_stands_at_one_place() -> None:
    parts = tomllib.loads((PROJECT / "results/ablation/parts.toml").read_text(encoding="utf-8"))
    for file, old, _ in (change for part in parts.values() for change in part["changes"]):
        assert (PROJECT / "src/spikingtac" / file).read_text().count(old) == 1, old
