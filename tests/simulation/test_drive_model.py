"""A simulated chair that answers commands as a drive model says, and the identification of its drive."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none
from small_rooms import room

from wheelsight.app.run.drives import WHEELS_FOLDER, wheels_recorded
from wheelsight.core.drive_model import DriveAxis, DriveModel
from wheelsight.core.messages import STOP, VelocityCommand
from wheelsight.core.robots import RobotLimits
from wheelsight.io.recordings import open_recording
from wheelsight_calibration.drive_fit import fit_drive
from wheelsight_calibration.drive_log import log_of_recording
from wheelsight_sim import SimulationSettings, Simulator

REAL = DriveModel("joystick", DriveAxis(0.27, 0.43, 0.45), DriveAxis(0.2, 0.12, 0.12))
# The ramps of commands are quick beside the drive's lag.
QUICK = RobotLimits(
    backward_m_s=1.0, acceleration_m_s2=3.0, braking_m_s2=5.0, turn_acceleration_rad_s2=10.0, jerk_m_s3=50.0
)
# A robot's own, but for the way back: ramps of most of a second, which the drive's model does not contain.
LIMITS = RobotLimits(backward_m_s=0.8)
SETTINGS = SimulationSettings(realism="ideal")


def simulator(limits: RobotLimits) -> Simulator:
    world = room('<geom name="floor" type="plane" size="60 60 1"/>')
    return Simulator(SETTINGS, world=world, has_camera=False, limits=limits, drive=REAL)


def test_a_stop_takes_the_way_of_the_model():
    with simulator(QUICK) as robot:
        for _ in range(80):
            robot.step(VelocityCommand(0.8, 0.0))
        begin = robot.T_world_base
        for _ in range(80):
            robot.step(STOP)
        gone_m = float(np.linalg.norm(robot.T_world_base[:2, 3] - begin[:2, 3]))
        assert robot.stop_reason == ""
    # 0.8 m/s for 0.72 s, and the ramp from 0.8 m/s by 5 m/s².
    assert gone_m == pytest.approx(0.8 * 0.72 + 0.8**2 / 10, rel=0.03)


@pytest.mark.slow
def test_a_minute_of_a_simulated_drive_identifies_it(tmp_path, rng):
    """Dead time within 20 ms, time constants within 10 %."""
    with simulator(LIMITS) as chair, wheels_recorded(chair, tmp_path, LIMITS) as robot:
        for period in range(1200):
            if period % 36 == 0:
                straight = 0.0 if period % 108 == 72 else float(rng.choice([-1, 1]) * rng.uniform(0.3, 0.8))
            if period % 44 == 0:
                turn = 0.0 if period % 132 == 88 else float(rng.choice([-1, 1]) * rng.uniform(0.3, 0.9))
            robot.step(VelocityCommand(straight, turn))
    model = fit_drive([log_of_recording(open_recording(tmp_path / WHEELS_FOLDER))]).model
    for found, true in ((model.straight, REAL.straight), (model.turn, REAL.turn)):
        axis = not_none(found)
        assert axis.dead_time_s == pytest.approx(not_none(true).dead_time_s, abs=0.02)
        assert axis.rise_s == pytest.approx(not_none(true).rise_s, rel=0.1)
        assert axis.fall_s == pytest.approx(not_none(true).fall_s, rel=0.1)
