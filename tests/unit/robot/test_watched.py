"""Windows of a camera whose every packet is a heartbeat of a watchdog."""

import time

from spikingtac.events.source import PacketSource
from spikingtac.robot.guard_loop import watched_windows
from spikingtac.robot.watchdog import Health, Watchdog
from spikingtac.stream.reader import EventReader
from stand_ins.moving_rims import SIZE, windows


def test_windows_come_in_order_and_a_consumer_that_lags_is_an_overload() -> None:
    # A busy machine is no stall.
    watchdog = Watchdog(lambda: None, time.monotonic, stale_s=20.0, backlog_s=0.1)
    watchdog.self_test()
    watchdog.arm()
    source, seen = PacketSource(list(windows(400, seed=0)), SIZE), list[int]()
    for window in watched_windows(EventReader(source, source), watchdog):
        seen.append(window[0].t_start_us)
        time.sleep(0.003)
        if watchdog.check() is not Health.OK:
            break
    assert seen == list(range(0, 1_000 * len(seen), 1_000))
    assert watchdog.health is Health.OVERLOAD
