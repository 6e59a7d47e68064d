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
    assert len({mutation.name for mutation in script.MUTATIONS}) == len(script.MUTATIONS)
    stale = {
        mutation.name: [path.name for path in found]
        for mutation in script.MUTATIONS
        if len(found := script.places(mutation)) != 1
    }
    assert stale == {}, (
        "the sources have changed: give each of these the text that stands there now"
    )


def test_every_mutation_changes_something_and_names_tests_that_exist(script: ModuleType) -> None:
    assert [mutation.name for mutation in script.MUTATIONS if mutation.old == mutation.new] == []
    missing = [
        f"{mutation.name}: {path}"
        for mutation in script.MUTATIONS
        for path in mutation.tests
        if not (PROJECT / path).exists()
    ]
    assert missing == []
