"""A user of a shared ring in a process of its own: it takes events, and tells what it missed.

python -m spikingtac_paper.live.user NAME MOST_EVENTS_PER_S
"""

from __future__ import annotations

import json
import subprocess
import sys
import time

from spikingtac.events import Address
from spikingtac.stream import RingCamera

POLL_S = 0.05
READY = "ready"


def use(name: str, most_ev_s: float) -> dict[str, int]:
    """Take events at a rate at most, until their writer ends; return the counts."""
    camera = RingCamera.open(Address.parse(f"ring:{name}"))
    sys.stdout.write(f"{READY}\n")
    sys.stdout.flush()
    taken, published = 0, 0
    while (rows := camera.read(POLL_S)) is not None:
        taken += len(rows[3])
        published = camera.published
        if most_ev_s < float("inf"):
            time.sleep(len(rows[3]) / most_ev_s)
    return {"taken": taken, "missed": camera.losses["missed"], "published": published}


class User:
    """A user in a process of its own.

    Args:
        name: Under which the events are shared.
        most_ev_s: It is slower than this.
    """

    def __init__(self, name: str, most_ev_s: float = float("inf")) -> None:
        words = [sys.executable, "-m", __name__, name, str(most_ev_s)]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        if self.process.stdout.readline().strip() != READY:
            raise RuntimeError(f"nothing is shared under {name!r}")

    def counts(self) -> dict[str, int]:
        """Wait for its end, and return ``taken``, ``missed`` and ``published`` events."""
        out, _ = self.process.communicate()
        return json.loads(out)


if __name__ == "__main__":
    sys.stdout.write(json.dumps(use(sys.argv[1], float(sys.argv[2]))))
