"""Break the package on purpose, one place at a time, and see whether the tests notice.

    python benchmarks/mutations.py                 # all, with the tests that should notice each
    python benchmarks/mutations.py lag-sign        # some, by name
    python benchmarks/mutations.py --whole-suite   # each against the whole suite: hours

A mutation is one text of a source file and what replaces it. The changes are made in a temporary
copy of the tree, without the folder of recordings: what a plain clone would notice is asked. The
exit status is 0 if the tests notice every mutation, 1 if one survives, 2 if the tests fail as they
stand or a mutation does not apply.
"""

import argparse
import functools
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
COPIED = ("src", "tests", "benchmarks", "docs", "examples", "pyproject.toml", "README.md")
PASSED, FAILED = 0, 1  # Exit codes of pytest; any other one means that the tests did not run.

# File in the copy with what pytest printed last, and how much of its end is shown.
LAST_OUTPUT, SHOWN_CHARACTERS = "last-output.txt", 4_000
PATIENCE_S = 3600.0
ACCURACY = "tests/regression"


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """One change that makes the package wrong.

    Attributes:
        name: What becomes wrong.
        old: Text that stands in the sources of ``src/spikingtac`` exactly once, in whichever file.
        new: What replaces it.
        tests: Files or folders of tests that should fail.
    """

    name: str
    old: str
    new: str
    tests: tuple[str, ...]


MUTATIONS = (
    Mutation(
        name="evt3-vector-advance",
        old="state[VECTOR_X] = column + length",
        new="state[VECTOR_X] = column + 12",
        tests=("tests/unit/events/evt/test_raw.py",),
    ),
    Mutation(
        name="evt-clock-wrap",
        old="state[EPOCH] += np.int64(1) << (low_bits + high_bits)",
        new="state[EPOCH] += np.int64(0)",
        tests=("tests/unit/events/evt/test_raw.py",),
    ),
    Mutation(
        name="evt3-joined-vectors",
        old="joined = state[3] == x[i] and state[4] == p[i]",
        new="joined = False",
        tests=("tests/unit/events/evt/test_raw.py",),
    ),
    Mutation(
        name="salvage-skip-cost",
        old="SKIP_COST = 4",
        new="SKIP_COST = 40",
        tests=("tests/unit/events/evt/test_salvage.py",),
    ),
    Mutation(
        name="lag-sign",
        old="locator.markers, self.lag_s,",
        new="locator.markers, -self.lag_s,",
        tests=(ACCURACY,),
    ),
    Mutation(
        name="lag-removed",
        old="markers, self.lag_s,",
        new="markers, 0.0,",
        tests=(ACCURACY,),
    ),
    Mutation(
        name="no-estimates-in-between",
        old="LONGEST_PERIOD_US = 2_000",
        new="LONGEST_PERIOD_US = 2_000_000_000",
        tests=(ACCURACY,),
    ),
    Mutation(
        name="turn-not-made-good",
        old="TURN_SHARE = 0.3",
        new="TURN_SHARE = 0.0",
        tests=("tests/unit/markers/graded/test_corrections.py",),
    ),
    Mutation(
        name="turn-told-alone",
        old="sum_x += direction[index[m, k], 0]",
        new="sum_x += direction[m, 0]",
        tests=("tests/unit/markers/graded/test_corrections.py",),
    ),
    Mutation(
        name="neighbours-ignored",
        old="shrunk = own_share[m] * noise2",
        new="shrunk = 0.0 * noise2",
        tests=("tests/unit/markers/graded/test_corrections.py",),
    ),
    Mutation(
        name="short-strokes-counted",
        old="np.hypot(stroke_x, stroke_y) > stroke_px[m]",
        new="np.hypot(stroke_x, stroke_y) > 0.0",
        tests=("tests/unit/markers/graded/test_event_loss.py",),
    ),
    Mutation(
        name="process-noise",
        old="ACCELERATION_NOISE_PX2_S3 = 1.0e6",
        new="ACCELERATION_NOISE_PX2_S3 = 5.0e3",
        tests=(ACCURACY,),
    ),
    Mutation(
        name="step-limit",
        old="LARGEST_STEP_PX = 2.0",
        new="LARGEST_STEP_PX = 20.0",
        tests=("tests/naive/test_disc_fit.py",),
    ),
    Mutation(
        name="lag-misfit-scale",
        old="scale = max(1.0, misfit / (len(along) - rank))",
        new="scale = 1.0",
        tests=("tests/unit/markers/test_lag.py",),
    ),
    Mutation(
        name="coasting-speed",
        old="marker.vx = marker.vy = 0.0",
        new="pass",
        tests=("tests/unit/markers/graded/test_disc_locator.py",),
    ),
    Mutation(
        name="capture-radius",
        old="CAPTURE_SHARE = 0.3",
        new="CAPTURE_SHARE = 3.0",
        tests=("tests/unit/markers/graded/test_track_management.py",),
    ),
    Mutation(
        name="contact-tail",
        old="STANDARD_ERRORS = 2.0",
        new="STANDARD_ERRORS = 0.0",
        tests=("tests/unit/contact/test_evidence.py",),
    ),
    Mutation(
        name="one-sided-holes",
        old="one_sided = _largest_gap_rad(points, start) > math.pi",
        new="one_sided = False",
        tests=("tests/unit/geometry/test_hole.py",),
    ),
)


def places(mutation: Mutation, project: Path = PROJECT) -> list[Path]:
    """Return the source file of each place with a mutation's old text: one if it applies.

    The text is searched in the whole package, so that a module may move.
    """
    texts = sources(project / "src" / "spikingtac")
    return [path for path, text in texts.items() for _ in range(text.count(mutation.old))]


@functools.cache
def sources(package: Path) -> dict[Path, str]:
    """Return the text of every source file of a package."""
    return {path: path.read_text(encoding="utf-8") for path in sorted(package.rglob("*.py"))}


def main() -> int:
    """Run the mutations that the command line names; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    names = [mutation.name for mutation in MUTATIONS]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of: {', '.join(names)}")
    parser.add_argument("--whole-suite", action="store_true", help="run every test, not the named")
    given = parser.parse_args()
    if unknown := set(given.names) - set(names):
        parser.error(f"no mutation {', '.join(sorted(unknown))} (valid: {', '.join(names)})")
    chosen = [mutation for mutation in MUTATIONS if mutation.name in (given.names or names)]
    if stale := [mutation.name for mutation in chosen if len(places(mutation)) != 1]:
        print(f"the sources have changed; mend the table of mutations: {', '.join(stale)}")
        return 2
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        return _run(chosen, Path(folder), given.whole_suite)


def _run(chosen: Sequence[Mutation], folder: Path, whole_suite: bool) -> int:
    project = _copied(folder / "project")
    tests = {mutation.name: ("tests",) if whole_suite else mutation.tests for mutation in chosen}
    code, took_s = _tested(project, sorted({path for some in tests.values() for path in some}))
    if code != PASSED:
        print((project / LAST_OUTPUT).read_text(errors="replace")[-SHOWN_CHARACTERS:])
        print("the tests fail as they stand, or cannot be run; mend them first")
        return 2
    print(f"{'unchanged':<24} passed    {took_s:6.0f} s", flush=True)
    codes = []
    for mutation in chosen:
        code, took_s = _mutated(project, mutation, tests[mutation.name])
        said = {PASSED: "SURVIVED", FAILED: "killed"}.get(code, f"exit {code}")
        print(f"{mutation.name:<24} {said:<9} {took_s:6.0f} s", flush=True)
        codes.append(code)
    survived = codes.count(PASSED)
    print(f"{codes.count(FAILED)} of {len(codes)} mutations killed, {survived} survived")
    return 0 if codes.count(FAILED) == len(codes) else 1 if survived else 2


def _mutated(project: Path, mutation: Mutation, tests: Sequence[str]) -> tuple[int, float]:
    (source,) = places(mutation, project)
    text, stamp = source.read_text(encoding="utf-8"), source.stat()
    source.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
    try:
        return _tested(project, tests)
    finally:
        source.write_text(text, encoding="utf-8")
        os.utime(source, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))


def _tested(project: Path, tests: Sequence[str]) -> tuple[int, float]:
    """Run tests in a copy of the tree; return pytest's exit code and the time that it took, s."""
    start_s = time.monotonic()
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider"]
    words += ["--timeout", "0"]  # kernels are compiled anew; a busy machine is no failure
    environment = {
        **os.environ,
        "PYTHONPATH": str(project / "src"),
        "SPIKINGTAC_DATA": str(project / "no-recordings"),
        "NUMBA_CACHE_DIR": str(project / ".numba_cache"),
    }
    done = subprocess.run(
        [*words, *tests], cwd=project, env=environment, capture_output=True, timeout=PATIENCE_S
    )
    (project / LAST_OUTPUT).write_bytes(done.stdout + done.stderr)
    return done.returncode, time.monotonic() - start_s


def _copied(project: Path) -> Path:
    project.mkdir()
    for name in COPIED:
        if (PROJECT / name).is_dir():
            shutil.copytree(
                PROJECT / name, project / name, ignore=shutil.ignore_patterns("__pycache__")
            )
        else:
            shutil.copy2(PROJECT / name, project / name)
    return project


if __name__ == "__main__":
    sys.exit(main())
