"""SessionClock: stamps of several sensors, mapped to one time whatever their clocks do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from changed_settings import numbers, variants
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.clock_faults import ClockLeaps, Sensors
from wheelsight.core.checks import ClockSettings, SessionClock, Untimed
from wheelsight.core.estimates import Reason
from wheelsight.core.messages import Event, SkippedFrame, WheelTicks, YawRate

LEAP_AT_S = 4.0


def drive(seconds: float = 8.0, camera_hz: float = 10.0, begin_s: float = 0.0, late_s: float = 0.0) -> list[Event]:
    """Wheels at 50 Hz and a camera, whose frames come `late_s` after their stamps, in the order in which they come."""
    wheels: list[Event] = [WheelTicks(begin_s + k / 50, k, k) for k in range(round(50 * seconds))]
    frames: list[Event] = [SkippedFrame(begin_s + k / camera_hz + 0.005, "") for k in range(round(camera_hz * seconds))]
    come = [*((e.stamp_s, e) for e in wheels), *((e.stamp_s + late_s, e) for e in frames)]
    return [event for _, event in sorted(come, key=lambda one: one[0])]


def times(clock: SessionClock, events: list[Event]) -> list[tuple[Event, float]]:
    """Events that have a time, with it."""
    reported = [(event, clock.time_of(event)) for event in events]
    return [(event, time_s) for event, time_s in reported if not isinstance(time_s, Untimed)]


def off_s(events: list[Event], leapt: list[Event], reported: list[tuple[Event, float]]) -> np.ndarray:
    """By how much the times of frames differ from those of wheels, at the true instants of both."""
    true_s = {id(now): before.stamp_s for before, now in zip(events, leapt, strict=True)}
    settled = [(event, time_s - true_s[id(event)]) for event, time_s in reported if true_s[id(event)] > LEAP_AT_S + 3]
    of_wheels = [off for event, off in settled if isinstance(event, WheelTicks)]
    return np.array([off for event, off in settled if isinstance(event, SkippedFrame)]) - of_wheels[-1]


@pytest.mark.parametrize("late_s", [0.0, 0.08])
def test_clocks_that_go_right_are_left_alone(late_s: float) -> None:
    clock, events = SessionClock(), drive(late_s=late_s)
    assert [(e, t) for e, t in times(clock, events) if t != e.stamp_s] == []
    assert len(times(SessionClock(), events)) == len(events)
    assert (clock.warnings, clock.shift_s) == ((), 0.0)


@pytest.mark.parametrize("late_s", [0.0, 0.08])
@pytest.mark.parametrize("camera_hz", [30.0, 10.0, 1.0])
@pytest.mark.parametrize("sensors", ["both", "wheels", "camera"])
@pytest.mark.parametrize("by_s", [60.0, -60.0, 3600.0, 86400.0, 1.6e9, 5.0, -5.0])
def test_a_leap_is_bridged_and_sensors_stay_together(
    by_s: float, sensors: Sensors, camera_hz: float, late_s: float
) -> None:
    clock, events = SessionClock(), drive(12.0, camera_hz, late_s=late_s)
    leapt = ClockLeaps(LEAP_AT_S, by_s, sensors).apply(events)
    reported = times(clock, leapt)
    assert len(reported) > 0.85 * len(events)
    session_s = [t for _, t in reported if isinstance(_, WheelTicks)]
    assert (np.diff(session_s) > 0).all()
    assert np.diff(session_s).max() < 1.6
    # Common leaps keep what lies between stamps; of one alone, the order in which events come shows to within a period.
    few_s = 0.001 if sensors == "both" else 0.1 if camera_hz > 5 else 0.3
    assert np.abs(off_s(events, leapt, reported)).max() < few_s
    (warning,) = clock.warnings
    assert ("wheels" in warning, "camera" in warning) == (sensors != "camera", sensors != "wheels")
    assert ("or all sensors paused that long" in warning) == (sensors == "both" and by_s > 0)


@pytest.mark.parametrize("by_s", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("sensors", ["wheels", "camera"])
def test_a_small_leap_of_one_clock_is_known_by_the_others_that_come_later_than_usual(
    sensors: Sensors, by_s: float
) -> None:
    clock, events = SessionClock(), drive()
    leapt = ClockLeaps(LEAP_AT_S, by_s, sensors).apply(events)
    reported = times(clock, leapt)
    assert np.abs(off_s(events, leapt, reported)).max() < 0.03
    assert len(reported) > len(events) - 10
    assert sensors in clock.warnings[0]


@pytest.mark.parametrize("asleep_s", [2.0, 300.0])
def test_a_host_that_sleeps_is_a_leap_of_all(asleep_s: float) -> None:
    clock, events = SessionClock(), drive()
    reported = times(clock, ClockLeaps(LEAP_AT_S, asleep_s, "both", missing_s=1.0).apply(events))
    steps_s = np.diff([t for _, t in reported])
    assert steps_s.max() == pytest.approx(0.4, abs=1e-6)
    assert reported[-1][1] + clock.shift_s == pytest.approx(events[-1].stamp_s + asleep_s)


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_single_stamps_far_away_are_noise(share: float) -> None:
    rng, clock = np.random.default_rng(5), SessionClock()
    events = drive()
    odd = [e if k < 20 or rng.random() > share else _off(e, rng.choice([-1e6, 1e3, 1e9])) for k, e in enumerate(events)]
    reported = times(clock, odd)
    honest = [(e, t) for e, t in reported if abs(e.stamp_s) < 100]
    assert max(abs(t - e.stamp_s) for e, t in honest) < 1e-9
    assert len(reported) == len(honest) > (1 - 1.3 * share) * len(events)


@pytest.mark.parametrize("stamp_s", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_has_no_time_and_moves_nothing(stamp_s: float) -> None:
    clock = SessionClock()
    events = drive()
    times(clock, events[:100])
    reported = clock.time_of(WheelTicks(stamp_s, 0, 0))
    assert isinstance(reported, Untimed)
    assert reported.reason is Reason.INVALID
    assert len(times(clock, events[100:])) == len(events) - 100


def test_a_stamp_that_comes_again_is_refused() -> None:
    clock = SessionClock()
    assert clock.time_of(WheelTicks(1.0, 0, 0)) == 1.0
    reported = clock.time_of(WheelTicks(1.0, 5, 5))
    assert reported == Untimed(Reason.CLOCK_BACKWARDS, "its stamp does not come after 1.000000 s")


@pytest.mark.parametrize("apart_s", [18.0, 1e9, -1e9])
def test_a_sensor_of_another_epoch_is_left_out_by_name(apart_s: float) -> None:
    clock = SessionClock()
    events = [_off(e, apart_s) if isinstance(e, SkippedFrame) else e for e in drive()]
    reported = times(clock, events)
    assert all(isinstance(event, WheelTicks) for event, _ in reported)
    (warning,) = clock.warnings
    assert warning.startswith("The camera is left out: the clock of the camera is ")
    assert "stamp all sensors by one clock" in warning


def test_for_a_gyroscope_no_wheels_are_left_out() -> None:
    clock = SessionClock()
    assert clock.time_of(YawRate(1e9, 0.0)) == 1e9
    assert clock.time_of(WheelTicks(1.0, 0, 0)) == 1.0
    assert isinstance(clock.time_of(YawRate(1e9 + 0.01, 0.0)), Untimed)
    assert "gyroscope" in clock.warnings[0]


def test_a_camera_alone_may_pause_and_may_be_slow() -> None:
    clock = SessionClock()
    stamps_s = [0.0, 5.0, 10.0, 1e6, 1e6 + 5]
    assert [clock.time_of(SkippedFrame(stamp_s, "")) for stamp_s in stamps_s] == stamps_s


def test_leaps_without_end_are_reported_ten_times() -> None:
    clock, events = SessionClock(), drive(60.0)
    for k in range(1, 20):
        events = ClockLeaps(events[0].stamp_s + 3.0 * k, 0.0).apply(events)
    leaping = [_off(e, 100.0 * (k // 180)) for k, e in enumerate(events)]
    times(clock, leaping)
    assert len(clock.warnings) == 10


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.floats(allow_nan=True, allow_infinity=True), st.integers(0, 5)), max_size=60
    )
)
def test_whatever_comes_the_times_of_a_sensor_grow(given_events: list[tuple[int, float, int]]) -> None:
    clock, stamp_s = SessionClock(), 0.0
    last: dict[int, float] = {}
    for kind, value, how in given_events:
        stamp_s = value if how == 0 else stamp_s + 0.02 * how
        event = (WheelTicks(stamp_s, 0, 0), SkippedFrame(stamp_s, ""), YawRate(stamp_s, 0.0))[kind]
        reported = clock.time_of(event)
        if not isinstance(reported, Untimed):
            assert np.isfinite(reported)
            assert reported > last.get(kind, -np.inf) or kind == 2  # a gyroscope gives way to wheels, and begins again
            last[kind] = reported


def _off(event: Event, by_s: float) -> Event:
    return replace(event, stamp_s=event.stamp_s + by_s)


def scenes() -> list[list[Event]]:
    """Clocks that leap by much and by little, together and alone, again and again; sensors that are slow or apart."""
    leaps: list[tuple[float, Sensors]] = [(60.0, "both"), (-60.0, "both"), (5.0, "wheels"), (-5.0, "camera")]
    small: list[tuple[float, Sensors]] = [(0.7, "wheels"), (-0.15, "both"), (2.0, "camera"), (0.3, "camera")]
    made = [
        ClockLeaps(LEAP_AT_S, by_s, sensors).apply(drive(12.0, camera_hz, late_s=0.05))
        for by_s, sensors in (*leaps, *small)
        for camera_hz in (10.0, 1.0)
    ]
    apart = [replace(e, stamp_s=e.stamp_s + 1.5) if isinstance(e, WheelTicks) else e for e in drive(3.0)]
    far_apart = [replace(e, stamp_s=e.stamp_s + 3.0) if isinstance(e, WheelTicks) else e for e in drive(3.0)]
    often = [replace(e, stamp_s=e.stamp_s + 3600 * (e.stamp_s // 5)) for e in drive(60.0)]
    both = list(ClockLeaps(LEAP_AT_S, 60.0, "both").apply(drive(12.0)))
    alike = [replace(e, stamp_s=e.stamp_s + 0.7) if isinstance(e, SkippedFrame) and e.stamp_s > 60 else e for e in both]
    slows = [
        e for e in drive(12.0) if not (isinstance(e, SkippedFrame) and e.stamp_s > 2 and round(10 * e.stamp_s) % 5)
    ]
    slow = [list(ClockLeaps(LEAP_AT_S, by_s, "camera").apply(slows)) for by_s in (60.0, 3.0, 0.7, 0.4)]
    return [*map(list, made), apart, far_apart, often, alike, *slow]


def reported_of(settings: ClockSettings, events: list[Event]) -> object:
    clock = SessionClock(settings)
    return [time_s if isinstance(time_s := clock.time_of(event), float) else None for event in events], clock.warnings


@pytest.mark.parametrize("name", numbers(ClockSettings))
def test_each_setting_changes_what_is_reported(name: str) -> None:
    assert any(
        reported_of(changed, events) != reported_of(ClockSettings(), events)
        for events in scenes()
        for changed in variants(ClockSettings, name)
        if isinstance(changed, ClockSettings)
    )
