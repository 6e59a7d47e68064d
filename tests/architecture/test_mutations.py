"""The table of mutations fits the sources: what it breaks is still there."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

from stand_ins.programs import program

PROJECT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return program("benchmarks/mutations.py")


def test_every_mutation_applies_at_one_place(script: ModuleType) -> None:
    found = {mutation.name: script.places(mutation) for mutation in script.MUTATIONS}
    assert len(found) == len(script.MUTATIONS), "two mutations of one name"
    assert {name: count for name, count in found.items() if count != 1} == {}


def test_every_mutation_names_tests_that_exist(script: ModuleType) -> None:
    missing = [
        f"{mutation.name}: {path}"
        for mutation in script.MUTATIONS
        for path in mutation.tests
        if not (PROJECT / path).exists()
    ]
    assert missing == []


def test_no_mutation_leaves_the_sources_as_they_are(script: ModuleType) -> None:
    assert [mutation.name for mutation in script.MUTATIONS if mutation.old == mutation.new] == []
