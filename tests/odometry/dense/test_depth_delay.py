"""The delay of depth against colour: learned from turns, and taken out of depth images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.dense.scenes import SMALL, Plane, frame_of

from wheelsight.core.calibration import Calibration
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame
from wheelsight.vision.dense import DenseSettings
from wheelsight.vision.dense.alignment import Gridder
from wheelsight.vision.dense.odometry import DepthDelay

CORNER = [Plane((0, 0, 1), 2.0), Plane((1, 0, 0), 0.7), Plane((0, 1, 0), 0.6)]


@pytest.mark.parametrize(("true_s", "known_s"), [(-0.02, 0.0), (0.012, 0.0), (-0.015, -0.015), (0.0, 0.0)])
def test_a_delay_is_learned_from_turns(true_s: float, known_s: float) -> None:
    """Frames are brought to colour's time by the delay in use; grey halves what is left to see."""
    rng, delay = np.random.default_rng(2), DepthDelay(known_s)
    for _ in range(600):
        turning = rng.uniform(-1.5, 1.5, 3)
        left_s = true_s - delay.seconds
        delay.learn(-0.5 * left_s * turning + 0.004 * rng.standard_normal(3), turning)
    assert delay.seconds == pytest.approx(true_s, abs=0.002)


def test_what_hardly_turns_shows_no_delay() -> None:
    delay = DepthDelay(0.0)
    for _ in range(200):
        delay.learn(np.array([0.002, 0.0, 0.0]), np.array([-0.1, 0.0, 0.0]))
    assert delay.seconds == 0.0


@pytest.mark.parametrize("late_s", [-0.03, 0.02])
def test_depth_of_another_instant_is_brought_to_that_of_colour(late_s: float) -> None:
    """By the frame's own stamps, and by what a calibration knows: a corner, of which depth is seen from elsewhere."""
    twist = np.array([0.3, -0.1, 0.2, 0.4, 1.2, -0.5])
    T_late = se3.exp(late_s * twist)
    color = frame_of(CORNER, np.eye(4), 0.0)
    late = replace(color, depth_m=frame_of(CORNER, T_late, 0.0).depth_m)
    registered = Calibration.registered_camera(SMALL)
    expected = gridded(registered, color, np.zeros(6))
    as_it_is = gridded(registered, late, twist)
    by_stamps = gridded(registered, replace(late, depth_late_s=late_s), twist)
    by_calibration = gridded(replace(registered, depth_late_s=late_s), late, twist)
    inside = (slice(20, -20), slice(20, -20))
    off = {n: np.median(np.abs(d - expected)[inside]) for n, d in (("is", as_it_is), ("stamps", by_stamps))}
    assert off["is"] > 4 * off["stamps"]
    assert off["stamps"] < 2e-3
    np.testing.assert_array_equal(by_stamps, by_calibration)


def gridded(calibration: Calibration, frame: RgbdFrame, twist: np.ndarray) -> np.ndarray:
    settings = DenseSettings()
    return Gridder(calibration, settings).on_grid(frame, twist).levels[0].depth_m
