"""The hour of driving: events come from another process, and each minute is looked at."""

from __future__ import annotations

from multiprocessing.connection import Connection

import numpy as np
import pytest

from benchmarks.live_hour import Hour, Minute, drive_hour, hour_sheets, judge_hour, memory_of, peak_mb
from wheelsight.app.run.kernels import DrawnDrive
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import PinholeCamera

_CAMERA = PinholeCamera(320, 240, 262.0, 260.0, 160.0, 120.0)
CALIBRATION = Calibration.registered_camera(_CAMERA, T_base_camera=np.eye(4), wheels=Wheels(0.17, 0.17, 0.52, 3200.0))


def send_drawn(minutes: float, connection: Connection) -> None:
    """The other process: a drive of 7 s through a drawn room."""
    source = DrawnDrive(CALIBRATION)
    connection.send(source.calibration)
    for event in source.events():
        connection.send(event)
    connection.send(None)


def _minutes(count: int, frame_ms: float = 10.0, grown_mb: float = 0.0) -> tuple[Minute, ...]:
    made = []
    for number in range(1, count + 1):
        late = number > count // 2
        made.append(Minute(number, 500.0 + grown_mb * number, 400.0, frame_ms if late else 10.0, 0.1, 7, 8, 9, 1.0))
    return tuple(made)


def test_memory_counts_at_its_most_and_time_from_the_second_quarter_on() -> None:
    memory, written, slower = judge_hour(Hour(_minutes(8, frame_ms=10.9, grown_mb=60.0), 200.0, 990.0, 0, 5))
    assert (memory.measured, written.measured) == (980.0, 990.0)
    assert [memory.is_met, written.is_met, slower.is_met] == [True, True, True]
    assert slower.measured == pytest.approx(9.0)
    of_growing = judge_hour(Hour(_minutes(8, frame_ms=12.0, grown_mb=70.0), 200.0, 1100.0, 0, 5))
    assert [target.is_met for target in of_growing] == [False, False, False]
    assert len(list(judge_hour(Hour(_minutes(3), 200.0, 600.0, 0, 5)))) == 2


def test_every_minute_has_a_row() -> None:
    by_minutes, in_all = hour_sheets(Hour(_minutes(4), 200.0, 600.0, 3, 5))
    assert [len(row) for row in by_minutes.rows] == [len(by_minutes.header)] * 4
    assert by_minutes.rows[3] == ("4", "500 MB", "400 MB", "10.0 ms", "0.10 ms", "7", "8", "9", "100 %")
    assert [row[1] for row in in_all.rows] == ["200 MB", "600 MB", "5", "3"]
    assert 10 < memory_of("Rss") <= peak_mb() + 1
    assert memory_of("Anonymous") < memory_of("Rss")


@pytest.mark.slow
def test_events_of_another_process_are_run_as_live_ones_and_each_minute_is_reported() -> None:
    reported: list[Minute] = []
    hour = drive_hour(0.1, reported.append, send_drawn, minute_s=1.5)
    assert hour.minutes == tuple(reported)
    assert [minute.number for minute in reported] == [1, 2, 3, 4]
    assert [minute.keyframes for minute in reported] == sorted(minute.keyframes for minute in reported)
    assert all(minute.frame_ms > minute.reading_ms > 0 and minute.surfels > 1000 for minute in reported)
    assert 0 < hour.start_mb < hour.peak_mb
