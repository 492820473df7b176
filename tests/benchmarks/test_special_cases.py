"""Switches from outside of the package, and the table of what rules gain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks import special_cases_drives
from benchmarks.special_cases import RULES, Comparison, Rule, counted, difference, row_of, without
from benchmarks.special_cases_drives import elevator, late_color, silence, wrong_depth
from wheelsight import Trajectory
from wheelsight.core.messages import RgbdFrame, WheelTicks


class Detector:
    """With a method and a property that a rule may turn off."""

    @property
    def limit(self) -> float:
        return 2.0

    def exceeds(self, value: float) -> bool:
        return value > self.limit


def rule_of(attribute: str, value: Any) -> Rule:
    return Rule("a rule", "filter", "one drive", "recordings", Detector, attribute, lambda *_: value)


def figures(error_m: float, wrong: int = 0) -> dict[str, Any]:
    return {
        "error_m": error_m,
        "end_m": error_m,
        "posed": 10,
        "tracking": 9,
        "wrong": wrong,
        "total": 10,
        "seconds": 1.0,
    }


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_each_rule_is_turned_off_and_on_again(rule: Rule) -> None:
    original = vars(rule.owner)[rule.attribute]
    with without(rule):
        assert vars(rule.owner)[rule.attribute] is not original
    assert vars(rule.owner)[rule.attribute] is original


def test_a_method_and_a_property_are_replaced() -> None:
    with without(rule_of("exceeds", False)):
        assert not Detector().exceeds(3.0)
    with without(rule_of("limit", 5.0)):
        assert not Detector().exceeds(3.0)
    assert Detector().exceeds(3.0)


def test_counting_changes_nothing() -> None:
    with counted([rule_of("exceeds", False)]) as counts:
        assert [Detector().exceeds(value) for value in (1.0, 3.0, 4.0)] == [False, True, True]
    assert counts["a rule"] == 2


def test_the_gain_is_the_mean_difference_with_its_standard_error() -> None:
    pairs = [Comparison("a", figures(0.1), figures(0.2, wrong=3)), Comparison("b", figures(0.2), figures(0.2))]
    assert np.allclose(difference(pairs), (0.05, 0.05))
    cells = row_of(rule_of("exceeds", False), [*pairs, Comparison("c", figures(0.1), None)], {"a": 2.0})
    assert cells[2:5] == ("2 of 3", "+0.0500 ± 0.0500 m", "1, 0")
    assert cells[7:] == ("0, 3", "-50 %")


def drive() -> tuple[list[WheelTicks | RgbdFrame], Trajectory]:
    events: list[WheelTicks | RgbdFrame] = []
    for number in range(200):
        stamp_s = number / 10
        events.append(WheelTicks(stamp_s, number, number))
        color = np.full((4, 4, 3), number, np.uint8)
        events.append(RgbdFrame(stamp_s + 0.01, color, np.ones((4, 4), np.float32), number))
    T = np.tile(np.eye(4), (201, 1, 1))
    T[:, 0, 3] = np.arange(201) / 10
    return events, Trajectory(np.arange(201) / 10, T, body="base")


def test_late_colour_is_that_of_two_frames_before() -> None:
    events, truth = drive()
    frames = [event for event in late_color(iter(events), truth)[0] if isinstance(event, RgbdFrame)]
    assert [int(frame.color[0, 0, 0]) for frame in frames[:5]] == [0, 0, 0, 1, 2]


def test_an_elevator_stops_the_wheels_and_then_shows_another_place() -> None:
    found, truth = elevator(iter(drive()[0]), drive()[1])
    events = list(found)
    stamps_s = np.array([event.stamp_s for event in events])
    assert (np.diff(stamps_s) > 0).all()
    ticks = np.array([event.left for event in events if isinstance(event, WheelTicks)])
    stands = int(special_cases_drives.STANDS_S * 10)
    assert np.count_nonzero(np.diff(ticks) == 0) == stands + 1
    assert np.diff(truth.T_frame_body[:, 0, 3]).max() > 7


def test_a_bus_that_hangs_gives_no_events_for_a_while() -> None:
    events, truth = drive()
    stamps_s = np.array([event.stamp_s for event in silence(iter(events), truth)[0]])
    assert np.diff(stamps_s).max() == pytest.approx(special_cases_drives.SILENT_S, abs=0.2)
    assert np.sort(np.diff(stamps_s))[-2] < 0.2


def test_depth_is_wrong_by_a_factor_until_a_time() -> None:
    events, truth = drive()
    changed = wrong_depth(iter(events), truth, 1.4, 5.0)[0]
    depths_m = {round(event.stamp_s, 2): event.depth_m.max() for event in changed if isinstance(event, RgbdFrame)}
    assert depths_m[4.91] == pytest.approx(1.4)
    assert depths_m[5.01] == 1.0
