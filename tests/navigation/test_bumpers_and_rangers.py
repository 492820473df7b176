"""Bumpers and ultrasonic rangers in the collision monitor: what a camera cannot see, such as glass, ends a drive."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from navigation.unicycle import CHAIR, Camera

from benchmarks.plain_rooms import Unicycle
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import NearbyMounts, Wheels
from wheelsight.core.errors import CalibrationError
from wheelsight.core.estimates import Status
from wheelsight.core.messages import NearbyReading, VelocityCommand
from wheelsight.io.devices.wire_formats import FrameDecoder, Nearby, encode_message
from wheelsight.navigation import CollisionMonitor, MonitorReason, MonitorState

MOUNTS = NearbyMounts(("front", "back"), ((0.8, 0.2, 0.0), (0.8, -0.2, 0.0)))
NOTHING = np.empty((0, 2))
GLASS_M = 4.0


class Ride:
    """A chair that is commanded straight on to a pane that no camera shows, and measures it."""

    def __init__(self, mounts: NearbyMounts | None = MOUNTS) -> None:
        self.monitor, self.base = CollisionMonitor(CHAIR, nearby=mounts), Unicycle((0.0, 0.0, 0.0))
        self.now_s, self.has_rangers, self.pressed = 0.0, True, (False, False)
        self.glass_m = GLASS_M
        self.monitor.trust_floor(2.5)

    def go(self, asked: VelocityCommand, seconds: float) -> MonitorReason | None:
        for _ in range(round(seconds / 0.05)):
            self.now_s += 0.05
            self.monitor.add_reading(self.now_s, self.base.forward_m_s, self.base.turn_rad_s)
            self.monitor.add_view(Camera().view(NOTHING, self.base.pose, self.now_s))
            if self.has_rangers:
                range_m = self.glass_m - float(self.base.pose[0]) - 0.8
                range_or_none_m = range_m if 0.02 < range_m < 4.3 else math.inf
                self.monitor.add_nearby(
                    NearbyReading(self.now_s, self.pressed, (range_or_none_m, range_or_none_m, math.nan, math.nan))
                )
            self.checked = self.monitor.check(asked, self.now_s, Status.TRACKING)
            self.base.step(self.checked.command)
        return self.checked.reason


@pytest.mark.parametrize("speed_m_s", [0.5, 1.0])
def test_it_stands_before_a_pane_that_its_rangers_measure(speed_m_s: float) -> None:
    ride = Ride()
    assert ride.go(VelocityCommand(speed_m_s), 9.0) is MonitorReason.OBSTACLE
    assert ride.base.stands
    assert 0.0 < GLASS_M - 0.8 - ride.base.pose[0] < 0.15
    deaf = Ride(None)
    deaf.has_rangers = False
    deaf.go(VelocityCommand(speed_m_s), 9.0)
    assert deaf.base.pose[0] > GLASS_M


def test_echoes_are_remembered_and_removed_once_the_pane_is_open() -> None:
    ride = Ride()
    ride.go(VelocityCommand(0.5), 9.0)
    assert len(ride.monitor.memory.remembered(3.0))
    ride.glass_m = 50.0
    assert ride.go(VelocityCommand(0.5), 2.0) is not MonitorReason.OBSTACLE
    assert not len(ride.monitor.memory.remembered(3.0))


def test_a_pressed_bumper_stops_it_and_it_may_only_leave() -> None:
    ride = Ride()
    ride.go(VelocityCommand(0.3), 2.0)
    ride.pressed = (True, False)
    for asked in (VelocityCommand(0.3), VelocityCommand(0.0, 0.3)):
        assert ride.go(asked, 0.05) is MonitorReason.BUMPER
        assert ride.checked.state is MonitorState.STOPPED
    ride.go(VelocityCommand(-0.1), 1.0)
    assert ride.base.forward_m_s < -0.02
    ride.pressed = (False, True)
    assert ride.go(VelocityCommand(-0.1), 0.05) is MonitorReason.BUMPER


def test_what_is_mounted_and_does_not_answer_stops_it() -> None:
    ride = Ride()
    ride.go(VelocityCommand(0.3), 2.0)
    ride.has_rangers = False
    assert ride.go(VelocityCommand(0.3), 0.6) is MonitorReason.NEARBY_SILENT
    for reading in (NearbyReading(9.0, (False,), (1.0, 1.0)), NearbyReading(9.0, (False, False), (1.0, math.nan))):
        other = Ride()
        other.now_s = 9.0 - 0.05
        other.has_rangers = False
        other.monitor.add_reading(8.9, 0.0, 0.0)
        other.monitor.add_nearby(reading)
        assert other.go(VelocityCommand(0.3), 0.05) is MonitorReason.NEARBY_SILENT


def test_a_message_gives_metres() -> None:
    message = Nearby(7, 0b10, 5831, 0, 0xFFFF, 1000)
    (decoded,) = FrameDecoder().feed(b"\0" + encode_message(message))
    assert decoded == message
    assert isinstance(decoded, Nearby)
    reading = decoded.reading(3.5)
    assert reading.is_pressed == (False, True)
    assert reading.ranges_m[0] == pytest.approx(1.0, abs=1e-4)
    assert reading.ranges_m[1] == math.inf
    assert math.isnan(reading.ranges_m[2])
    assert reading.stamp_s == 3.5


def test_mounts_are_in_the_calibration_file(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    calibration = Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200), nearby=MOUNTS)
    save_calibration(calibration, path)
    assert load_calibration(path).nearby == MOUNTS
    assert load_calibration(path, under=replace(calibration, nearby=None)).nearby == MOUNTS
    text = path.read_text(encoding="utf-8")
    for wrong, problem in (
        (text.replace("front", "left"), "bumpers are"),
        (text.replace("[0.8, 0.2, 0.0]", "[0.8, 0.2]"), "rangers are"),
        (text.replace("[0.8, 0.2, 0.0]", "[0.8, .nan, 0.0]"), "rangers are"),
        (text.replace("[0.8, 0.2, 0.0]", "[8.0, 0.2, 0.0]"), "rangers are"),
        (text.replace("[front, back]", "front"), "nearby.bumpers is no list"),
    ):
        assert wrong != text
        path.write_text(wrong, encoding="utf-8")
        with pytest.raises(CalibrationError, match=problem):
            load_calibration(path)
