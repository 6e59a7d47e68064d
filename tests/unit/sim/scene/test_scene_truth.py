import pytest

from spikingtac.sim.source import prefetch


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
