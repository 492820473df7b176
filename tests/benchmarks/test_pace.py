"""The pace of drives by rays, in a room small enough for seconds."""

from __future__ import annotations

import pytest
from navigation.true_plans import START, plan_of

from benchmarks import pace
from benchmarks.exploration_truth import TruePlan

pytestmark = pytest.mark.slow


def room() -> TruePlan:
    return plan_of(5.0, 4.0)


def test_a_goal_is_reached_and_all_time_has_a_cause() -> None:
    (drive,) = pace.paces_in(room(), "room", START, 1, 1, explores=False)
    assert not drive.ended
    assert drive.clearance_m > 0
    assert sum(drive.spent_s.values()) == pytest.approx(drive.time_s, abs=0.2)
    (sheet, targets) = pace.sheets_of([drive], explores=False)
    assert len(sheet.rows) == 2
    assert len(targets.rows) == 1


def test_a_room_is_explored() -> None:
    (drive,) = pace.paces_in(room(), "room", START, 1, 1, explores=True)
    assert not drive.ended
    assert drive.seen_percent > 95
    assert drive.clearance_m > 0
    assert len(pace.sheets_of([drive], explores=True)[1].rows) == 3
