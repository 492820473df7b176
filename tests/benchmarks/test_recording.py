"""Recording at a camera's rate: how it is measured, and what it is held against."""

from __future__ import annotations

from hand_fed_camera import CALIBRATION, live_frame

from benchmarks.recording import Recorded, encoded, in_time, judge, recorded


def test_frames_come_over_and_over_in_their_time() -> None:
    frames = [live_frame(number, 0.0).frame for number in range(3)]
    coming = in_time(frames)
    found = [next(coming) for _ in range(5)]
    assert [frame.color[0, 0, 0] for frame in found] == [0, 1, 2, 0, 1]
    assert [round(30 * frame.stamp_s, 6) for frame in found] == [0, 1, 2, 3, 4]


def test_what_is_recorded_and_lost_is_all_that_came() -> None:
    frames = [live_frame(number, 0.0).frame for number in range(3)]
    run = recorded(CALIBRATION, frames, "png", 1.0)
    assert run.frames + sum(run.lost.values()) <= 30 * run.seconds + 2
    assert run.frames > 0
    assert run.size_mb > 0
    assert run.cpu_s > 0


def test_a_dropped_frame_is_a_miss() -> None:
    run = Recorded("png", 10.0, 299, {"slow disk": 1}, 170.0, 5.98)
    rate, dropped, cores = judge([run])
    assert (rate.is_met, dropped.is_met, cores.is_met) == (True, False, True)
    assert cores.measured == 0.6
    assert run.row == ("png", "299", "29.9", "slow disk 1", "20.0", "0.60", "17.0")


def test_each_encoder_is_timed_and_jpeg_is_not_for_depth() -> None:
    rows = list(encoded([live_frame(1, 0.0).frame]))
    assert len({row[0] for row in rows}) == 5
    assert rows[-1][3:] == ("—", "—")
