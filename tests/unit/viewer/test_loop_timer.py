import pytest

from spikingtac.viewer.loop_timer import LoopTimer


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept_s: list[float] = []

    def read(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.slept_s.append(duration_s)
        self.now_s += duration_s


def run(clock: Clock, timer: LoopTimer, work_s: float) -> None:
    timer.begin()
    clock.now_s += work_s
    timer.end()
    timer.wait()


def test_it_sleeps_what_the_work_left_of_the_period() -> None:
    clock = Clock()
    timer = LoopTimer(period_s=0.01, clock=clock.read, sleep=clock.sleep)
    for _ in range(3):
        run(clock, timer, work_s=0.004)
    assert clock.slept_s == pytest.approx([0.006] * 3)
    report = timer.report()
    assert (report.steps, report.overruns) == (3, 0)
    assert report.p50_us == pytest.approx(4000)


def test_a_late_step_is_counted_and_not_made_up_for() -> None:
    clock = Clock()
    timer = LoopTimer(period_s=0.01, clock=clock.read, sleep=clock.sleep)
    run(clock, timer, work_s=0.035)
    run(clock, timer, work_s=0.002)
    assert timer.report().overruns == 1
    assert timer.report().worst_us == pytest.approx(35_000)
    assert clock.slept_s == pytest.approx([0.008])


def test_a_period_must_be_positive() -> None:
    with pytest.raises(ValueError, match="must be positive"):
        LoopTimer(period_s=0.0)


def test_before_the_first_step_the_report_is_zero() -> None:
    assert LoopTimer(period_s=1.0).report().worst_us == 0.0
