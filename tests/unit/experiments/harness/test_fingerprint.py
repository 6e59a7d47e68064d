"""What a result depends on: the code behind it, all of it, and no other."""

from spikingtac.experiments.harness.fingerprint import PACKAGE, SHARED, code_digest, modules_behind
from spikingtac.experiments.trials.methods import main_methods


def test_what_is_imported_counts_directly_or_not() -> None:
    behind = modules_behind(("markers/published/blob_tracker.py",))
    assert {
        "markers/published/blob_tracker.py",
        "markers/published/blobs.py",
        "state_map/binary.py",
    } <= set(behind)
    assert "events/filter_kernels.py" in behind, "imported inside of a function"
    assert "markers/graded/tracker.py" not in behind
    assert not set(SHARED) & set(behind)


def test_imports_are_followed_within_a_folder_where_that_is_asked() -> None:
    behind = modules_behind(("sim/scene/render.py",), within="sim")
    assert "sim/gel/gel.py" in behind
    assert all(name.startswith("sim/") for name in behind)


def test_a_folder_brings_its_weights() -> None:
    behind = modules_behind(("denoise/weights",))
    assert any(name.endswith(".onnx") for name in behind)


def test_every_method_names_modules_that_exist() -> None:
    for method in main_methods().values():
        behind = modules_behind(method.code)
        assert all((PACKAGE / name).is_file() for name in behind), method.name
        assert code_digest(behind)


def test_work_on_our_own_trackers_leaves_the_baselines_results_alone() -> None:
    for name in ("paper", "evetac", "neutac", "ekalibr"):
        behind = modules_behind(main_methods()[name].code)
        assert not {"markers/graded/tracker.py", "markers/graded/disc_locator.py"} & set(behind), (
            name
        )
