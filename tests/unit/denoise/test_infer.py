import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from spikingtac.denoise import infer
from spikingtac.denoise.classical import make_denoiser
from spikingtac.denoise.infer import NetworkDenoiser, shipped_denoiser
from spikingtac.errors import ConfigError
from spikingtac.state_map.binary import paint_binary_discs

# How far the int8 network's logistic function may be off (denoise/network/blocks.py).
LOGISTIC_ERROR = 0.022


WEIGHTS = Path(infer.__file__).parent / "weights"


def test_buffers_are_reused_and_follow_the_size():
    denoiser = NetworkDenoiser(WEIGHTS / "lean-int8.onnx")
    small, large = np.zeros((20, 30), np.float32), np.ones((65, 33), np.float32)
    first = denoiser.clean(small)
    assert first.shape == (20, 30)
    assert denoiser.clean(small) is first
    kept = first.copy()
    assert denoiser.clean(large).shape == (65, 33)
    assert np.array_equal(denoiser.clean(small), kept)


def test_a_map_of_no_two_sides_is_refused():
    with pytest.raises(ConfigError, match=r"\(height, width\).*\(3, 4, 5\)"):
        NetworkDenoiser(WEIGHTS / "lean.onnx").clean(np.zeros((3, 4, 5), np.float32))


@pytest.mark.parametrize("content", [None, b"", b"not a network", b"\x08\x09" * 500])
def test_what_is_no_network_is_refused(tmp_path, content):
    path, told = tmp_path / "network.onnx", "cannot read the network"
    if content is not None:
        path.write_bytes(content)
        told = r"no network that ONNX Runtime can read|another origin"
    with pytest.raises(ConfigError, match=told):
        NetworkDenoiser(path)


def test_one_flipped_bit_is_found(tmp_path):
    weights = shutil.copytree(WEIGHTS, tmp_path / "weights")
    content = bytearray((weights / "lean-int8.onnx").read_bytes())
    content[len(content) // 2] ^= 1
    (weights / "lean-int8.onnx").write_bytes(content)
    with pytest.raises(ConfigError, match="is damaged: its sha256 is"):
        NetworkDenoiser(weights / "lean-int8.onnx")


def test_a_foreign_network_is_refused(tmp_path):
    onnx = pytest.importorskip("onnx")
    head = '<ir_version: 9, opset_import: ["": 17]>'
    text = f"{head} foreign (float[1] x) => (float[1] y) {{y = Identity(x)}}"
    onnx.save(onnx.parser.parse_model(text), tmp_path / "foreign.onnx")
    with pytest.raises(ConfigError, match=r"another origin.*\['x', 'y'\]"):
        NetworkDenoiser(tmp_path / "foreign.onnx")


def noisy_markers() -> tuple[np.ndarray, np.ndarray]:
    """The paper's 64 markers, and the same map with a tenth of its pixels wrong."""
    columns, rows = np.meshgrid(np.arange(8.0), np.arange(8.0))
    grid = np.float64(33.0) + 37.0 * np.stack([columns, rows], -1).reshape(-1, 2)
    clean = paint_binary_discs((320, 320), grid, np.full(64, 7.0))
    wrong = np.random.default_rng(0).random(clean.shape) < 0.1
    return clean, np.where(wrong, 1 - clean, clean).astype(np.float32)


@pytest.mark.parametrize("name", ["network", "network-int8"])
def test_the_shipped_networks_clean_a_noisy_map(name):
    clean, noisy = noisy_markers()
    cleaned = make_denoiser(name).clean(noisy)
    assert cleaned.shape == clean.shape
    assert 0.0 <= cleaned.min() <= cleaned.max() <= 1.0
    wrong = ((cleaned >= 0.5) != (clean >= 0.5)).mean()
    assert wrong < 0.02, "a tenth of the pixels was wrong before"


def test_shipped_int8_agrees_with_float():
    _, noisy = noisy_markers()
    one = shipped_denoiser("network").clean(noisy)
    other = shipped_denoiser("network-int8").clean(noisy)
    apart = np.abs(one - other)
    assert apart.mean() < LOGISTIC_ERROR
    assert ((one >= 0.5) != (other >= 0.5)).mean() < 0.01
    rim = (one > 0.3) & (one < 0.7)
    assert rim.sum() > 300
    assert apart[rim].mean() < 0.05


def test_onnxruntime_is_loaded_only_for_a_network():
    code = (
        "import spikingtac.denoise.classical, spikingtac.denoise.infer, sys;"
        "print('onnxruntime' in sys.modules, 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
