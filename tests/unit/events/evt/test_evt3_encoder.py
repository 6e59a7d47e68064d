"""Which words the EVT3 encoder chooses: few, and each of them needed."""

from __future__ import annotations

import numpy as np

from spikingtac.events.evt.encode import Evt3Encoder
from spikingtac.events.evt.wire import ADDR_X, BASE_X, VECT_8, VECT_12

TRIPLE = [VECT_12, VECT_12, VECT_8]  # What holds 32 pixels.


def kinds(x: np.ndarray, p: np.ndarray | None = None) -> list[int]:
    """Return the types of the words that place events of one row and time, without time and row."""
    count = len(x)
    words = Evt3Encoder().encode(
        np.full(count, 5, np.int64),
        x.astype(np.uint16),
        np.full(count, 7, np.uint16),
        np.ones(count, np.bool_) if p is None else p,
    )
    wanted = {ADDR_X, BASE_X, VECT_8, VECT_12}
    return [kind for kind in (words >> 12).tolist() if kind in wanted]


def test_a_long_row_needs_one_base() -> None:
    """The decoder moves the base on by the vectors' 32 pixels: the next ones need none."""
    assert kinds(np.arange(10, 10 + 3 * 32)) == [BASE_X, *TRIPLE, *TRIPLE, *TRIPLE]


def test_vectors_are_used_where_they_take_fewer_words() -> None:
    """With its base a triple takes four words, without it three: as many events are cheaper."""
    assert kinds(np.arange(4)) == 4 * [ADDR_X]
    assert kinds(np.arange(5)) == [BASE_X, *TRIPLE]
    assert kinds(np.arange(32 + 3)) == [BASE_X, *TRIPLE, *(3 * [ADDR_X])]
    assert kinds(np.arange(32 + 4)) == [BASE_X, *TRIPLE, *TRIPLE]
