"""What a live stream may need is compiled before it begins, damage included."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
import gc
from spikingtac.cameras.words import warm_up
from spikingtac.events.evt.words import WordStream
from spikingtac.events.formats.codec import Triggers
from spikingtac.events.evt.encode import ENCODERS
from spikingtac.types import LossCounters

encoding, SIZE = sys.argv[1], (320, 320)
rng = np.random.default_rng(0)
t = np.sort(rng.integers(1_000, 400_000, 40_000)).astype(np.int64)
x, y = (rng.integers(0, 320, len(t)).astype(np.uint16) for _ in range(2))
sound = ENCODERS[encoding]().encode(t, x, y, x > y).tobytes()

def compiled():
    return {
        f"{one.py_func.__module__}.{one.py_func.__name__}": sorted(map(str, one.signatures))
        for one in gc.get_objects() if isinstance(one, Dispatcher)
    }

def damaged(number):
    data = bytearray(sound)
    at = int(rng.integers(1_000, len(data) - 9_000))
    if number % 3 == 1:  # a cut, in a word and between words
        del data[at : at + int(rng.choice([1, 3, 5, 8_000]))]
    elif number % 3 == 2:  # noise, or zeros
        data[at : at + 4_000] = rng.bytes(4_000) if number % 2 else bytes(4_000)
    return bytes(data)

warm_up(encoding, SIZE)
before = compiled()
for number in range(24):
    data = damaged(number)
    stream = WordStream(encoding, SIZE, LossCounters(), Triggers())
    pieces = [data[first : first + 3_001] for first in range(0, len(data), 3_001)]
    for piece in pieces:
        stream.feed(piece)
    stream.feed(b"", final=True)
after = compiled()
print([name for name in after if after[name] != before.get(name)])
"""


@pytest.mark.parametrize("encoding", ["evt2", "evt21", "evt3"])
def test_damage_leaves_nothing_to_compile(encoding: str, tmp_path: Path) -> None:
    words = [sys.executable, "-c", SCRIPT, encoding]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr
