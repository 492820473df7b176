"""Recordings of holonomic bases: written, read again, exported to a bag, and looked at."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wheelsight.app.run import run_each
from wheelsight.config import Config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import HolonomicWheels, Wheels
from wheelsight.core.errors import OutputError, RecordingError
from wheelsight.core.geometry import se2
from wheelsight.core.messages import Event, HolonomicReading, OdometryReading, WheelCounts, WheelTicks, YawRate
from wheelsight.io.recordings import OpenOptions, RecordingWriter, open_recording
from wheelsight.io.recordings.inspection import inspect_recording
from wheelsight_export.bag import export_bag
from wheelsight_export.sources import exported_at

MECANUM = HolonomicWheels("mecanum", radius_m=0.05, half_length_m=0.2, half_width_m=0.15, ticks_per_turn=4096)
OMNI = HolonomicWheels("omni", radius_m=0.05, distance_m=0.2, angles_rad=(1.0472, 3.1416, 5.236), ticks_per_turn=4096)
INCREMENTS = HolonomicWheels("increments")
TWIST = np.array([0.1, 0.4, 0.2])
KINDS = pytest.mark.parametrize("wheels", [MECANUM, OMNI, INCREMENTS], ids=["mecanum", "omni", "increments"])


def readings_of(wheels: HolonomicWheels) -> list[HolonomicReading]:
    """Of four seconds at a constant twist: 1.65 m of way."""
    found: list[HolonomicReading] = []
    for stamp_s in (0.02 * np.arange(201)).tolist():
        if wheels.wheel_names:
            counts = np.rint(wheels.jacobian @ TWIST * stamp_s / wheels.m_per_tick)
            found.append(WheelCounts(100 + stamp_s, tuple(int(count) for count in counts)))
        else:
            x, y, yaw = (float(part) for part in se2.to_parts(se2.exp(TWIST * stamp_s)))
            found.append(OdometryReading(100 + stamp_s, x, y, yaw))
    return found


def written(folder: Path, wheels: HolonomicWheels) -> list[Event]:
    events: list[Event] = [*readings_of(wheels), YawRate(104.5, 0.2)]
    with RecordingWriter(folder, Calibration(holonomic=wheels)) as writer:
        for event in events:
            writer.add(event)
    assert writer.readings == 201
    return events


@KINDS
def test_readings_come_back_as_they_were(wheels: HolonomicWheels, tmp_path: Path) -> None:
    events = written(tmp_path / "drive", wheels)
    recording = open_recording(tmp_path / "drive")
    assert list(recording.events()) == events
    assert recording.calibration.holonomic == wheels
    assert recording.wheel_count == 201
    inspection = inspect_recording(recording)
    assert inspection.wheel_readings == 201
    assert inspection.wheels is not None
    assert "holonomic base" in inspection.wheels


@KINDS
def test_a_run_goes_the_whole_way(wheels: HolonomicWheels, tmp_path: Path) -> None:
    written(tmp_path / "drive", wheels)
    (record,) = run_each(open_recording(tmp_path / "drive"), Config(), tmp_path / "out")
    way_m = np.linalg.norm(np.diff(record.estimate.positions_m, axis=0), axis=1).sum()
    assert way_m == pytest.approx(4 * np.hypot(*TWIST[:2]), rel=2e-3)
    assert len(record.estimate) == 201


@KINDS
@pytest.mark.parametrize("name", ["drive.bag", "drive.mcap"])
def test_a_bag_of_it_holds_the_same(wheels: HolonomicWheels, name: str, tmp_path: Path) -> None:
    events = written(tmp_path / "drive", wheels)
    export_bag(exported_at(tmp_path / "drive"), tmp_path / name)
    bag = open_recording(tmp_path / name)
    assert bag.calibration.holonomic == wheels
    readings = [event for event in bag.events() if isinstance(event, HolonomicReading)]
    for reported, event in zip(readings, events, strict=False):
        assert reported.stamp_s == pytest.approx(event.stamp_s, abs=1e-6)
        if isinstance(reported, WheelCounts) and isinstance(event, WheelCounts):
            assert reported.counts == event.counts
        else:
            assert isinstance(reported, OdometryReading)
            assert isinstance(event, OdometryReading)
            given = (event.x_m, event.y_m, event.yaw_rad)
            assert (reported.x_m, reported.y_m, reported.yaw_rad) == pytest.approx(given, abs=1e-9)
    assert len(readings) == 201


def test_a_mecanum_base_may_keep_its_own_odometry(tmp_path: Path) -> None:
    written(tmp_path / "drive", INCREMENTS)
    (tmp_path / "wheels.yaml").write_text(
        "format: wheelsight-calibration-1\nwheels: {kind: holonomic, layout: mecanum, radius_m: 0.05, "
        "half_length_m: 0.2, half_width_m: 0.15, ticks_per_turn: 4096}\n"
    )
    recording = open_recording(tmp_path / "drive", OpenOptions(calibration=tmp_path / "wheels.yaml"))
    assert {type(event) for event in recording.events()} == {OdometryReading, YawRate}


def test_columns_of_other_wheels_are_refused_with_what_to_say(tmp_path: Path) -> None:
    written(tmp_path / "drive", INCREMENTS)
    (tmp_path / "two.yaml").write_text(
        "format: wheelsight-calibration-1\nwheels: {kind: differential, left_radius_m: 0.1, right_radius_m: 0.1, "
        "track_width_m: 0.4, ticks_per_turn: 1000}\n"
    )
    with pytest.raises(RecordingError, match=r"wheels.csv: has x_m, y_m, yaw_rad, .*say `kind: holonomic`"):
        open_recording(tmp_path / "drive", OpenOptions(calibration=tmp_path / "two.yaml"))


def test_readings_of_other_wheels_are_not_written(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "drive", Calibration(holonomic=MECANUM)) as writer:
        with pytest.raises(RecordingError, match=r"a WheelTicks of 2 numbers .*stamp_s,front_left,front_right"):
            writer.add(WheelTicks(0.0, 1, 2))
        with pytest.raises(RecordingError, match="a WheelCounts of 3 numbers has no place here"):
            writer.add(WheelCounts(0.0, (1, 2, 3)))
    with (
        RecordingWriter(tmp_path / "two", Calibration(wheels=Wheels(0.1, 0.1, 0.4, 1000))) as writer,
        pytest.raises(RecordingError, match=r"wheels.csv has stamp_s,left,right"),
    ):
        writer.add(OdometryReading(0.0, 1.0, 2.0, 3.0))


def test_it_goes_on_where_it_was_broken_off_with_the_same_wheels_alone(tmp_path: Path) -> None:
    written(tmp_path / "drive", MECANUM)
    with RecordingWriter(tmp_path / "drive", Calibration(holonomic=MECANUM), resume=True) as writer:
        with pytest.raises(RecordingError, match=r"does not come after|grow"):
            writer.add(WheelCounts(100.0, (0, 0, 0, 0)))
        writer.add(WheelCounts(105.0, (1, 2, 3, 4)))
    assert writer.readings == 202
    with pytest.raises(OutputError, match=r"its wheels\.csv has stamp_s,front_left"):
        RecordingWriter(tmp_path / "drive", Calibration(holonomic=OMNI), resume=True)
