"""A drive in the rehearsal's room: no simulator, no map folder; the localization knows the true pose."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wheelsight.app.run.drive_record import DriveRecord, DriveRecorder
from wheelsight.app.run.drives import GoalDrive, OnEvents
from wheelsight.app.run.kernel_process import DrawnRobot, TrueLocalization, drawn_room
from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import PinholeCamera
from wheelsight.core.robots import WatchedRobot
from wheelsight.navigation import KnownFloor, Navigator, Transition

CAMERA = PinholeCamera(320, 240, 262.0, 260.0, 160.0, 120.0)
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
CALIBRATION = Calibration.registered_camera(
    CAMERA, wheels=Wheels(0.17, 0.17, 0.52, 3200.0), T_base_camera=T_BASE_CAMERA, source="test"
)
# The camera sees no floor nearer than 2.6 m: onto that it drives at the speed for floor that was not seen lately.
QUICK = {"navigation.monitor.blind_m_s": 0.5}


def rehearsed_drive(
    on_events: OnEvents = lambda events: None, on_transition: Callable[[Transition], None] = lambda transition: None
) -> tuple[GoalDrive, DrawnRobot, Config]:
    robot, config = DrawnRobot(CALIBRATION), load_config(overrides=QUICK)
    watched, recorder = WatchedRobot(robot), DriveRecorder(config.navigation.footprint.outline)
    watched.listeners += [recorder.add, on_events]
    floor = KnownFloor(drawn_room())
    localization = TrueLocalization(robot)
    navigator = Navigator(
        watched, localization, floor, config.navigation, trusts_floor=True, on_transition=on_transition
    )
    return GoalDrive(watched, recorder, navigator, drawn_room, "a room"), robot, config


def recorded(drive: GoalDrive, config: Config, asked: int = 1, *, is_interrupted: bool = False) -> DriveRecord:
    truth = {"clearance_m": 0.2, "contacts": []}
    return drive.record(asked, "a drawn robot", config, truth, is_interrupted=is_interrupted)
