"""The seeds of the experiment on what is felt: which are run, kept apart and refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from spikingtac.errors import ConfigError
from spikingtac_paper.harness.run import RunOptions
from spikingtac_paper.touch import experiment
from spikingtac_paper.touch.twin_slip import (
    CONTACTS,
    HELD_CONTACTS,
    HELD_SEED,
    SEED_STRIDE,
    SEEDS,
    TAUGHT_SEED,
)


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """First methods and seeds of the parts that were run, of which none does anything."""
    ran: list[tuple[str, int]] = []

    def record(methods: list[str], seed: int, quick: bool) -> list[dict[str, Any]]:
        ran.append((methods[0], seed))
        trial = {"case": "slip/all", "groups": [], "seed": seed, "source": "twin"}
        return [{"method": methods[0], "trial": trial, "scores": {"sticking_s": 1.0}}]

    for part in experiment.SIMULATED:
        monkeypatch.setitem(experiment.SIMULATED, part, record)
    return ran


METHODS = ("touches", "patch-model", "slip")


def test_touches_have_three_seeds_and_the_other_parts_one(
    tmp_path: Path, ran: list[tuple[str, int]]
) -> None:
    experiment.run(RunOptions(output=tmp_path / "run", methods=METHODS))
    assert ran == [("touches", 0), ("touches", 1), ("touches", 2), ("patch-model", 0), ("slip", 0)]


def test_a_number_of_seeds_is_that_of_every_part(
    tmp_path: Path, ran: list[tuple[str, int]]
) -> None:
    options = RunOptions(output=tmp_path / "run", methods=METHODS, seed=4, seeds=2, quick=True)
    experiment.run(options)
    assert ran == [(method, seed) for method in METHODS for seed in (4, 5)]


@pytest.mark.usefixtures("ran")
@pytest.mark.parametrize(("first", "count"), [(7, None), (0, 2)])
def test_results_of_other_seeds_are_never_mixed(
    tmp_path: Path, first: int, count: int | None
) -> None:
    options = RunOptions(output=tmp_path / "run", methods=METHODS)
    experiment.run(options)
    again = replace(options, resume=True)
    experiment.run(again)
    with pytest.raises(ConfigError, match="never mixed"):
        experiment.run(replace(again, seed=first, seeds=count))


@pytest.mark.parametrize(("first", "count"), [(15, 1), (13, 3), (-1, 1), (20, 1)])
def test_seeds_of_contacts_that_slip_was_learned_from_are_refused(
    tmp_path: Path, ran: list[tuple[str, int]], first: int, count: int
) -> None:
    folder = tmp_path / "run"
    options = RunOptions(output=folder, methods=("slip",), seed=first, seeds=count)
    with pytest.raises(ConfigError, match=rf"seeds {first} to .* are given.*0 to 14"):
        experiment.run(options)
    assert not ran
    assert not folder.exists()


def test_other_parts_have_no_last_seed(tmp_path: Path, ran: list[tuple[str, int]]) -> None:
    options = RunOptions(output=tmp_path / "run", methods=METHODS[:2], seed=20, seeds=1)
    experiment.run(options)
    assert ran == [("touches", 20), ("patch-model", 20)]


def test_no_contact_that_is_scored_was_learned_from() -> None:
    last = HELD_SEED + SEEDS[-1] * SEED_STRIDE + max(CONTACTS, HELD_CONTACTS)
    assert last <= TAUGHT_SEED
