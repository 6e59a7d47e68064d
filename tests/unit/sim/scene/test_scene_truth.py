import numpy as np
import pytest

from spikingtac.sim.scene.scene import SkinConfig
from spikingtac.sim.scene.source import prefetch
from spikingtac.sim.states import MarkerImage, TruthChunk


def image(t_us: int, center: float, stretch: float = 1.0) -> MarkerImage:
    return MarkerImage(
        t_us=t_us,
        center_px=np.full((2, 2), center),
        shape=np.tile(np.diag([1.0 / stretch, 1.0]), (2, 1, 1)),
        radius_px=np.array([7.0, 0.0]),
    )


@pytest.mark.parametrize(("period_us", "rows"), [(500, 1), (1000, 1), (2000, 2), (4000, 4)])
def test_rows_come_every_millisecond_or_faster(period_us: int, rows: int):
    state = SkinConfig(grid=(1, 2)).at_rest()
    chunk = TruthChunk.of_step(state, image(8000, 10.0), image(8000 + period_us, 14.0))
    np.testing.assert_array_equal(
        chunk.marker_t_us, 8000 + period_us // rows * np.arange(rows, dtype=np.int64)
    )
    np.testing.assert_allclose(chunk.marker_px[:, 0, 0], 10.0 + 4.0 * np.arange(rows) / rows)
    assert chunk.marker_px.dtype == np.float32
    assert chunk.contact_t_us.tolist() == [8000]
    assert chunk.force_n.shape == chunk.pose_mm.shape == (1, 3)
    assert chunk.marker_depth_mm.shape == (1, 2)
    np.testing.assert_allclose(chunk.marker_radius_px, [[7.0, 0.0]])


def test_working_ahead_changes_neither_items_nor_order():
    assert list(prefetch(range(1000), 3)) == list(range(1000))
    assert list(prefetch([], 3)) == []


def test_an_error_comes_in_its_place():
    def items():
        yield 1
        raise ValueError("broken")

    stream = prefetch(items(), 8)
    assert next(stream) == 1
    with pytest.raises(ValueError, match="broken"):
        next(stream)


def test_leaving_early_ends_the_thread():
    made = []

    def items():
        for number in range(10**9):
            made.append(number)
            yield number

    stream = prefetch(items(), 4)
    assert next(stream) == 0
    stream.close()
    count = len(made)
    assert count <= 8
    assert len(made) == count
