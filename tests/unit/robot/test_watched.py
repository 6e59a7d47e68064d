"""Windows of a camera whose every packet is a heartbeat of a watchdog."""

import time
from collections.abc import Iterator

from spikingtac.events.formats.codec import Triggers
from spikingtac.robot.guard_loop import watched_windows
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.reader import EventReader
from spikingtac.types import EventPacket, LossCounters
from stand_ins.moving_rims import SIZE, windows


class Stream:
    """400 packets at once."""

    size = SIZE

    def __init__(self) -> None:
        self.losses, self.triggers = LossCounters(), Triggers()

    def __iter__(self) -> Iterator[EventPacket]:
        return iter(windows(400, seed=0))


def test_windows_come_in_order_and_a_consumer_that_lags_is_an_overload() -> None:
    # A busy machine is no stall.
    watchdog = Watchdog(lambda: None, time.monotonic, stale_s=20.0, backlog_s=0.1)
    watchdog.self_test()
    watchdog.arm()
    seen: list[int] = []
    for window in watched_windows(EventReader(Stream(), Stream()), watchdog):
        seen.append(window[0].t_start_us)
        time.sleep(0.003)
        if watchdog.check() is not Health.OK:
            break
    assert seen == list(range(0, 1_000 * len(seen), 1_000))
    assert watchdog.health is Health.OVERLOAD
