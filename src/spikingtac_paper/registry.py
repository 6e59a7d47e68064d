"""The experiments and the benches by name; each module is imported when it is run."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from spikingtac.errors import named
from spikingtac_paper.harness.run_options import RunOptions

Runner = Callable[[RunOptions], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Study:
    """An experiment or a bench.

    Attributes:
        module: Module with ``run(options) -> summary``.
        about: What it measures, a few words for the help.
        divided: Whether its tasks are divided among processes, or done one by one in this one.
    """

    module: str
    about: str
    divided: bool = True


EXPERIMENTS: dict[str, Study] = {
    "point-tracking": Study(
        "spikingtac_paper.point_tracking.experiment", "marker tracking, section V-A"
    ),
    "denoise": Study("spikingtac_paper.denoise.experiment", "denoisers, section IV-B"),
    "collision": Study("spikingtac_paper.collision.experiment", "stopping at contact, section V-B"),
    "holes": Study("spikingtac_paper.holes.experiment", "holes by touch, section V-C"),
    "touch": Study("spikingtac_paper.touch.experiment", "forces, wrenches, touches", divided=False),
    "real": Study("spikingtac_paper.real_gels.experiment", "recordings of real gels"),
}
"""Name -> experiment, for ``spikingtac experiment``."""

BENCHES: dict[str, Study] = {
    "throughput": Study("spikingtac_paper.throughput.bench", "rates and latencies of this machine"),
    "skins": Study(
        "spikingtac_paper.throughput.skins", "how the cost grows with markers and events"
    ),
}
"""Name -> bench, for ``spikingtac bench``."""


def choices_text(studies: dict[str, Study]) -> str:
    """Return the names and what they measure as one line of help."""
    return "; ".join(f"{name} ({study.about})" for name, study in studies.items()) + "."


def runner_of(studies: dict[str, Study], name: str, kind: str) -> Runner:
    """Return the function that runs an experiment or a bench.

    Args:
        studies: :data:`EXPERIMENTS` or :data:`BENCHES`.
        name: Which of them.
        kind: What they are, for the error.

    Raises:
        ConfigError: There is none of that name.
    """
    return importlib.import_module(named(studies, name, kind).module).run
