"""When events are handed out, and which frames are dropped, by a clock that no machine makes faster or slower."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest
from stand_ins import frame
from virtual_time import VirtualClock

from wheelsight.app.run.realtime import THREAD, MonotonicClock, Playing
from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks, YawRate
from wheelsight.core.settings import RealTimeSettings
from wheelsight.io.recordings import ListedFrame

START_S = 5e8
Said = tuple[float, Event]


def frames(count: int, period_s: float = 0.1) -> list[Event]:
    return [frame(index, START_S + index * period_s) for index in range(count)]


def ticks(count: int, period_s: float = 0.02) -> list[Event]:
    return [WheelTicks(START_S + index * period_s, index, index) for index in range(count)]


def in_order(*events: list[Event]) -> list[Event]:
    return sorted((event for each in events for event in each), key=lambda event: event.stamp_s)


def play(clock: VirtualClock, items: Iterator[Event | ListedFrame], work: Callable[[Event], float]) -> Playing:
    """All of it; what was taken when, seconds after the first stamp, is left in `said`."""
    playing = Playing(items, clock)
    said: list[Said] = []
    while (event := playing.take()) is not None:
        said.append((round(playing.now_s - START_S, 6), event))
        if (seconds := work(event)) > 0:
            clock.sleep(seconds)
    playing.close()
    playing.said = said  # type: ignore[attr-defined]
    return playing


def said_by(playing: Playing) -> list[Said]:
    return playing.said  # type: ignore[attr-defined]


def indices(playing: Playing) -> list[int]:
    return [event.index for _, event in said_by(playing) if isinstance(event, RgbdFrame | SkippedFrame)]


def of_frames(seconds: float) -> Callable[[Event], float]:
    return lambda event: seconds if isinstance(event, RgbdFrame) else 0.0


def listed(clock: VirtualClock, count: int, decoding_s: float, read: list[int] | None = None) -> list[ListedFrame]:
    """Frames at ten a second that take a while to decode."""

    def decode(index: int) -> RgbdFrame:
        clock.sleep(decoding_s)
        if read is not None:
            read.append(index)
        return frame(index, START_S + 0.1 * index)

    stamps_s = [START_S + 0.1 * index for index in range(count)] + [float("inf")]
    return [
        ListedFrame(stamps_s[index], stamps_s[index + 1], lambda index=index: decode(index))  # type: ignore[misc]
        for index in range(count)
    ]


def test_each_event_comes_when_its_stamp_does() -> None:
    events = in_order(ticks(150), frames(30))
    playing = play(VirtualClock(), iter(events), lambda _: 0.0)
    assert [event for _, event in said_by(playing)] == events
    assert [at_s for at_s, _ in said_by(playing)] == pytest.approx([event.stamp_s - START_S for event in events])
    assert (playing.frames, playing.dropped, playing.unread, playing.readings) == (30, 0, 0, 150)
    assert playing.played_s == pytest.approx(2.98)


def test_who_is_as_fast_as_the_camera_loses_nothing() -> None:
    playing = play(VirtualClock(), iter(frames(20)), of_frames(0.099))
    assert indices(playing) == list(range(20))


def test_who_takes_two_and_a_half_periods_gets_the_newest_frame_each_time_and_never_falls_behind() -> None:
    playing = play(VirtualClock(), iter(frames(21)), of_frames(0.25))
    assert indices(playing) == [0, 2, 5, 7, 10, 12, 15, 17, 20]
    assert (playing.frames, playing.dropped) == (21, 12)
    assert all(at_s - (event.stamp_s - START_S) < 0.1 for at_s, event in said_by(playing))


def test_readings_all_come_in_their_order_however_slow_one_is() -> None:
    readings = in_order(ticks(150), [YawRate(START_S + 0.005 + 0.01 * k, 0.1) for k in range(290)])
    playing = play(VirtualClock(), iter(in_order(readings, frames(30))), of_frames(0.73))
    said = [event for _, event in said_by(playing)]
    assert [event for event in said if not isinstance(event, RgbdFrame)] == readings
    assert [event.stamp_s for event in said] == sorted(event.stamp_s for event in said)
    assert playing.readings == len(readings)
    assert playing.dropped == 30 - len(indices(playing)) > 20


def test_a_long_pause_costs_frames_but_not_the_newest() -> None:
    clock, work = VirtualClock(), {3: 1.55}
    playing = play(clock, iter(frames(40)), lambda event: work.get(event.index, 0.0))  # type: ignore[union-attr]
    assert indices(playing) == [0, 1, 2, 3, *range(18, 40)]
    assert playing.dropped == 14


def test_at_most_a_few_frames_are_held_however_long_no_one_takes_them() -> None:
    clock, decoded = VirtualClock(), []

    def items() -> Iterator[Event]:
        for event in frames(100):
            decoded.append(event)
            yield event

    playing = Playing(items(), clock)
    playing.take()
    clock.sleep(2.05)
    # The frame of 2.0 s, the newest, and three to come are held; one more waits for room.
    assert len(decoded) == 21 + RealTimeSettings().frames_ahead
    assert playing.dropped == 19
    playing.close()


def test_a_frame_that_was_overtaken_before_it_was_decoded_never_is() -> None:
    clock = VirtualClock()
    read: list[int] = []
    playing = play(clock, iter(listed(clock, 40, 0.15, read)), lambda _: 0.0)
    assert playing.unread == playing.dropped == 40 - len(read) > 5
    assert indices(playing) == read
    # What is decoded ahead before the clock runs comes in time; then each is late by what decoding it takes, at most
    # a period more.
    assert all(at_s - 0.1 * event.index < 0.25001 for at_s, event in said_by(playing))  # type: ignore[union-attr]


def test_decoding_that_is_fast_enough_delays_nothing() -> None:
    clock = VirtualClock()
    playing = play(clock, iter(listed(clock, 40, 0.09)), lambda _: 0.0)
    assert [at_s for at_s, _ in said_by(playing)] == pytest.approx([0.1 * index for index in range(40)])


def test_frames_that_cannot_be_read_count_as_frames() -> None:
    events: list[Event] = [*frames(3), SkippedFrame(START_S + 0.3, "no image", 3)]
    playing = play(VirtualClock(), iter(events), lambda _: 0.0)
    assert indices(playing) == [0, 1, 2, 3]
    assert playing.frames == 4


def test_what_stops_the_recording_is_raised_after_all_that_came_before() -> None:
    def broken() -> Iterator[Event]:
        yield from frames(3)
        raise RecordingError("the disk went away")

    playing = Playing(broken(), VirtualClock())
    taken = [playing.take() for _ in range(3)]
    assert [event.index for event in taken] == [0, 1, 2]  # type: ignore[union-attr]
    with pytest.raises(RecordingError, match="the disk went away"):
        playing.take()
    playing.close()


def test_nothing_at_all_ends_at_once() -> None:
    playing = Playing(iter([]), VirtualClock())
    assert playing.take() is None
    playing.close()
    assert (playing.played_s, playing.frames) == (0.0, 0)


def test_what_is_heard_from_elsewhere_comes_between() -> None:
    clock = VirtualClock()
    playing = Playing(iter(frames(3)), clock)
    assert playing.shown_s(clock.now_s()) is None
    assert isinstance(playing.take(), RgbdFrame)
    clock.sleep(0.05)
    assert playing.shown_s(clock.now_s()) == pytest.approx(START_S + 0.05)
    heard = [WheelTicks(START_S + 0.04, 1, 1), WheelTicks(float("nan"), 2, 2)]
    for reading in heard:
        playing.add(reading)
    assert [playing.take(), playing.take()] == heard
    assert playing.take().index == 1  # type: ignore[union-attr]
    playing.close()
    assert playing.readings == 2


def test_closing_ends_the_thread_and_the_source_in_the_middle() -> None:
    ended: list[bool] = []

    def endless() -> Iterator[Event]:
        try:
            for index in range(10**9):
                yield frame(index % 200, 0.001 * index)
        finally:
            ended.append(True)

    playing = Playing(endless(), MonotonicClock())
    for _ in range(3):
        playing.take()
    playing.close()
    assert ended == [True]
    assert not any(thread.name == THREAD for thread in threading.enumerate())


def test_by_the_hosts_clock_events_are_never_early() -> None:
    playing = Playing(iter(frames(4, period_s=0.02)), MonotonicClock())
    while (event := playing.take()) is not None:
        assert playing.now_s >= event.stamp_s
    playing.close()
