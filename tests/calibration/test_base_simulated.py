"""The whole way on rendered drives: injected mounts and clocks against what is found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wheelsight_calibration.base import QUANTITIES, calibrate_base, mount_values
from wheelsight_calibration.wheel_drive import drive_of
from wheelsight_calibration.wheels import fit_wheels
from wheelsight_sim import RobotModel, SimulationSettings, simulate
from wheelsight_sim.faults import LateClock
from wheelsight_sim.simulated_recording import SimulatedRecording, with_camera_faults

ANGLE = np.radians(0.5)
LIMITS: dict[str, float] = {"roll": ANGLE, "pitch": ANGLE, "yaw": ANGLE, "x": 0.01, "y": 0.01, "height": 0.01}
CASES: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {
    "flat": (
        {"world": "flat", "seed": 2, "rate_hz": 6},
        {
            "camera_left_m": 0.08,
            "camera_forward_m": 0.28,
            "camera_height_m": 0.8,
            "camera_pitch_rad": 0.25,
            "camera_yaw_rad": 0.15,
            "camera_roll_rad": -0.05,
            "left_radius_m": 0.1734,
            "right_radius_m": 0.1683,
            "track_width_m": 0.53,
        },
        0.03,
    ),
    "corridor": (
        {"world": "floor4", "seed": 4, "rate_hz": 5, "duration_s": 52.0},
        {"camera_forward_m": 0.45, "camera_pitch_rad": 0.4, "camera_roll_rad": 0.1, "camera_height_m": 1.2},
        -0.05,
    ),
}


def delay_of_body_s(recording: SimulatedRecording) -> float:
    """How late the robot's body follows its wheels, which creep on the floor under load; part of what is found."""
    nominal = recording.calibration.wheels
    assert nominal is not None
    return fit_wheels(nominal, drive_of(recording, nominal), recording.ground_truth, segment_m=0.3).wheels.delay_s


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_injected_mount_and_clock_are_found(name: str) -> None:
    drive, robot, late_s = CASES[name]
    settings = SimulationSettings(**drive, size=(320, 240), robot=RobotModel(**robot))
    recording = with_camera_faults(simulate(settings), LateClock(late_s=late_s))
    found = calibrate_base(recording)
    body_s = delay_of_body_s(recording)
    expected = mount_values(settings.robot.T_base_camera) | {"delay": body_s - late_s}
    off = {quantity: found.values[quantity] - expected[quantity] for quantity in QUANTITIES}
    reported = {quantity: (off[quantity], found.sigmas[quantity]) for quantity in QUANTITIES}
    assert abs(body_s) < 0.01
    for quantity, limit in (LIMITS | {"delay": 0.005}).items():
        assert abs(off[quantity]) < limit, reported
        assert found.sigmas[quantity] < limit, reported
        assert abs(off[quantity]) < 4 * found.sigmas[quantity], reported
