"""Simulated time goes as the wall's, and no faster to make up for what was late."""

from __future__ import annotations

import pytest

from wheelsight.app.page.session import RealTimePace


class Clocks:
    """Both, by hand."""

    def __init__(self) -> None:
        self.robot_s, self.wall_s, self.slept_s = 100.0, 7.0, 0.0

    def sleep(self, seconds: float) -> None:
        self.wall_s += seconds
        self.slept_s += seconds

    def steps(self, pace: RealTimePace, count: int, takes_s: float) -> None:
        for _ in range(count):
            self.robot_s += 0.05
            self.wall_s += takes_s
            pace.wait()


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


def paced(clocks: Clocks) -> RealTimePace:
    return RealTimePace(lambda: clocks.robot_s, lambda: clocks.wall_s, clocks.sleep)


def test_a_quick_robot_waits(clocks: Clocks) -> None:
    pace = paced(clocks)
    clocks.steps(pace, 100, 0.01)
    assert clocks.slept_s == pytest.approx(4.0)
    assert pace.share == pytest.approx(1.0, abs=0.02)


def test_a_slow_step_is_made_up_for_by_the_next_ones(clocks: Clocks) -> None:
    pace = paced(clocks)
    for _ in range(20):
        clocks.steps(pace, 1, 0.14)
        clocks.steps(pace, 3, 0.01)
    assert pace.share == pytest.approx(1.0, abs=0.05)
    assert clocks.wall_s == pytest.approx(7.0 + 80 * 0.05, abs=0.01)


def test_a_slow_robot_goes_on_at_once_and_never_hurries(clocks: Clocks) -> None:
    pace = paced(clocks)
    clocks.steps(pace, 100, 0.1)
    assert clocks.slept_s == 0
    assert pace.share == pytest.approx(0.5, abs=0.02)
    clocks.slept_s = 0.0
    clocks.steps(pace, 100, 0.01)
    assert clocks.slept_s > 3.4
