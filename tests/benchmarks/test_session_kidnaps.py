"""A drive that is cut in two, with a dark in between."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import sessions
from benchmarks.session_kidnaps import FIND_S, Kidnapping, carried_off
from wheelsight.core.messages import Event, RgbdFrame, WheelTicks, YawRate

SIZE = (3, 4)


@pytest.fixture
def events() -> list[Event]:
    """20 s of a drive with 5 frames and 10 readings a second; the wheels turn a tick each tenth of a second."""
    made: list[Event] = []
    for k in range(200):
        made.append(WheelTicks(0.1 * k, 3 * k, 2 * k))
        made.append(YawRate(0.1 * k + 0.01, 0.5))
        if k % 2 == 0:
            made.append(RgbdFrame(0.1 * k + 0.02, np.full((*SIZE, 3), 90, np.uint8), np.ones(SIZE, np.float32)))
    return made


def test_stamps_grow_and_counts_stand_in_the_dark_and_go_on_from_there(events: list[Event]) -> None:
    cut = list(carried_off(events, 6.0, 14.0, dark_s=4.0))
    stamps_s = [event.stamp_s for event in cut]
    assert stamps_s == sorted(stamps_s)
    ticks = [event for event in cut if isinstance(event, WheelTicks)]
    dark = [event for event in ticks if 6.0 <= event.stamp_s < 10.0]
    assert {(event.left, event.right) for event in dark} == {(3 * 59, 2 * 59)}
    assert len(dark) == 40
    after = [event for event in ticks if event.stamp_s >= 10.0]
    assert (after[0].left, after[0].right) == (3 * 59, 2 * 59)
    assert (after[10].left - after[0].left, after[10].right - after[0].right) == (30, 20)
    assert after[0].stamp_s == pytest.approx(10.0)


@pytest.mark.parametrize("to_s", [2.0, 16.0])
def test_the_light_comes_back_at_once_wherever_to_it_was_carried(events: list[Event], to_s: float) -> None:
    """Carried back to the drive's begin, it saw nothing for as long as it was watched, and was not counted as lost."""
    cut = list(carried_off(events, 14.0, to_s, dark_s=4.0))
    assert cut[0].stamp_s == pytest.approx(14.0 - FIND_S)
    frames = [event for event in cut if isinstance(event, RgbdFrame) and event.color.any()]
    assert next(frame.stamp_s for frame in frames if frame.stamp_s >= 14.0) == pytest.approx(18.02)


def test_it_is_dark_meanwhile_and_nothing_turns(events: list[Event]) -> None:
    cut = list(carried_off(events, 6.0, 14.0, dark_s=4.0))
    frames = [event for event in cut if isinstance(event, RgbdFrame)]
    is_dark = [not event.color.any() and not event.depth_m.any() for event in frames]
    assert [event.stamp_s for event, dark in zip(frames, is_dark, strict=True) if dark] == pytest.approx(
        [6.02 + 0.2 * k for k in range(20)]
    )
    assert {event.yaw_rate_rad_s for event in cut if isinstance(event, YawRate) and 6.0 <= event.stamp_s < 10.0} == {
        0.0
    }


def test_only_who_had_found_itself_counts() -> None:
    taken = [
        Kidnapping("flat", "joined", 10.0, 20.0, True, False, True, 2.0),
        Kidnapping("flat", "joined", 12.0, 22.0, True, True, False, None),
        Kidnapping("flat", "joined", 14.0, 24.0, False, False, False, None),
    ]
    assert sessions.kidnapping_sheet(taken).rows == (("flat, joined", "3", "2", "1", "1", "2.0", "1"),)
    assert sessions.judge([], [], taken)[-1].measured == pytest.approx(50.0)
