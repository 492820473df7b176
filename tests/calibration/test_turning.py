from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sighted_drives import MOUNT, NOMINAL, USUAL, sighted, with_late_camera

from wheelsight_calibration.mount import common_turning
from wheelsight_sim import RobotModel


@pytest.mark.parametrize("late_s", [-4.0, -0.3, 0.0, 0.24, 7.5])
def test_up_and_delay_are_found(rng: np.random.Generator, late_s: float) -> None:
    """A camera stamped late sees the wheels early."""
    seen = with_late_camera(sighted(rng=rng, blur=USUAL), late_s)
    turning = common_turning(seen.drive, NOMINAL, seen.camera)
    assert turning.delay_s == pytest.approx(-late_s, abs=0.021)
    assert np.degrees(np.arccos(turning.up_camera @ MOUNT[2, :3])) < 0.5
    assert turning.agreement > 0.98


def test_a_camera_may_hang_upside_down() -> None:
    T_base_camera = RobotModel(camera_roll_rad=np.pi).T_base_camera
    seen = sighted(T_base_camera=T_base_camera)
    turning = common_turning(seen.drive, NOMINAL, seen.camera)
    np.testing.assert_allclose(turning.up_camera, T_base_camera[2, :3], atol=1e-3)


def test_a_track_that_is_wrong_does_not_matter() -> None:
    seen = sighted(replace(NOMINAL, track_width_m=0.7))
    assert common_turning(seen.drive, NOMINAL, seen.camera).agreement > 0.999


def test_without_turns_nothing_agrees(rng: np.random.Generator) -> None:
    seen = sighted(legs=[(20.0, 0.8, 0.0)], rng=rng, blur=USUAL)
    assert common_turning(seen.drive, NOMINAL, seen.camera).agreement < 0.6


def test_another_drive_does_not_agree(rng: np.random.Generator) -> None:
    seen = sighted(rng=rng, blur=USUAL)
    other = sighted(legs=[(1.0 + 0.37 * n % 2.3, 0.5, 0.9 * (-1) ** (n * n // 3)) for n in range(25)])
    assert common_turning(other.drive, NOMINAL, seen.camera).agreement < 0.6
