"""TrackingState: when an odometry has begun, fails, and is lost."""

from __future__ import annotations

import pytest

from wheelsight.core.estimates import Status, TrackingState

NOT_YET, T, F, L = Status.INITIALIZING, Status.TRACKING, Status.FAILING, Status.LOST


@pytest.mark.parametrize(
    ("frames", "reported"),
    [
        ("xx", [NOT_YET, NOT_YET]),
        ("xxxxo", [NOT_YET, NOT_YET, NOT_YET, NOT_YET, T]),
        ("oxxxo", [T, F, F, L, T]),
        ("oxxox", [T, F, F, T, F]),
        ("oxxxx", [T, F, F, L, L]),
    ],
)
def test_states_follow_what_frames_come_to(frames: str, reported: list[Status]) -> None:
    state, found = TrackingState(lost_after=3), []
    for frame in frames:
        state = state.tracked() if frame == "o" else state.failed()
        found.append(state.status)
    assert found == reported


def test_what_has_not_begun_is_not_lost() -> None:
    state = TrackingState(lost_after=1).failed().failed()
    assert (state.status, state.is_lost, state.failures) == (NOT_YET, False, 2)
