import numpy as np
import pytest

from spikingtac.viewer.web.wire import decode, encode


def test_what_goes_in_comes_out() -> None:
    arrays = {
        "field": np.arange(10, dtype=np.float32).reshape(5, 2),
        "held": np.array([1, 0, 1], np.uint8),
        "none": np.empty((0, 2), np.float32),
        "counts": np.array([70_000], np.uint32),
    }
    meta, found = decode(encode({"t_us": -5, "label": "λ"}, arrays))
    assert meta == {"t_us": -5, "label": "λ"}
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


@pytest.mark.parametrize("length", range(9))
def test_arrays_are_aligned_for_browsers(length: int) -> None:
    message = encode({"s": "x" * length}, {"a": np.zeros(3, np.uint8), "b": np.ones(1)})
    body = 8 + int.from_bytes(message[4:8], "little")
    assert body % 8 == 0
    assert len(message) == body + 16


@pytest.mark.parametrize("message", [b"", b"STV", b"XXXX\x02\x00\x00\x00{}"])
def test_foreign_bytes_are_refused(message: bytes) -> None:
    with pytest.raises(ValueError, match="frame message"):
        decode(message)


def test_what_json_cannot_say_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        encode({"t_us": float("nan")}, {})
