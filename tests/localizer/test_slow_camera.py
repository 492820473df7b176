"""A camera on wheels, alone, too slow for its turns: what fits badly is doubted, and no pose is wrong unsaid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from grids import mostly_slow

from wheelsight.config import load_config
from wheelsight.core.geometry import se3, so3
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import express_for
from wheelsight_sim import (
    ManualVelocities,
    Renderer,
    RobotModel,
    SimulatedRecording,
    SimulationSettings,
    build_world,
    camera_model,
    simulate_drive,
)

SIZE, SECONDS = (320, 240), 3.6
STAMPS_S, YAW_RATES = (0, 1, 2, 3, 3.5), (0, math.pi / 2, 0, -math.pi / 2, 0)


def spin(seed: int) -> SimulatedRecording:
    """On the spot in a furnished flat, a quarter to and fro at 90°/s, seen by five frames a second."""
    settings = SimulationSettings("flat", size=SIZE, seed=seed, duration_s=SECONDS, rate_hz=5)
    world = build_world("flat", seed)
    drive = simulate_drive(
        world, RobotModel(), ManualVelocities(STAMPS_S, np.zeros(5), YAW_RATES), seed=seed, time_limit_s=SECONDS
    )
    return SimulatedRecording(settings, world, drive, Renderer(world, drive, settings, camera_model("kinect-v1", SIZE)))


@pytest.mark.parametrize("seed", mostly_slow([1, 4, 5], quick=[1]))
def test_at_five_frames_a_second_turns_of_a_right_angle_a_second_are_followed_or_said_to_be_lost(seed: int) -> None:
    recording = spin(seed)
    truth = express_for("camera", recording.ground_truth, recording.true_calibration)
    settings = load_config(overrides={"odometry": "dense", "map": "surfels"})
    subject, apart = Localizer(recording.calibration, settings), []
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    T_first = truth.at(frames[0].stamp_s)[0]
    T_map_first = recording.calibration.T_base_camera
    assert T_map_first is not None
    for frame in frames:
        answer = subject.process(frame)
        if answer is not None and answer.T_odom_body is not None:
            T_true = T_map_first @ se3.invert(T_first) @ truth.at(frame.stamp_s)[0]
            T = se3.invert(T_true) @ answer.T_odom_body @ T_map_first
            apart.append((np.linalg.norm(T[:3, 3]), so3.angle(T[:3, :3])))
    assert len(apart) > 0.6 * len(frames)
    assert (np.array(apart) < (0.1, math.radians(5))).all()
