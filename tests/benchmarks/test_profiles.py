"""What a profile costs: how default and profile are held against each other."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic import CAMERA, render_room, wobbling_trajectory

from benchmarks.first_pose import Followed, judge
from benchmarks.profiles import Cost, configs, costs_of, ratio_sheet
from wheelsight.core.calibration import Calibration
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer


def test_both_settings_follow_the_same_frames_and_are_distinguished() -> None:
    truth = wobbling_trajectory(8)
    frames = [
        RgbdFrame(float(s), *render_room(T), index)
        for index, (s, T) in enumerate(zip(truth.stamps_s, truth.T_frame_body, strict=True))
    ]
    calibration = Calibration.registered_camera(CAMERA)
    localizers = {name: Localizer(calibration, one) for name, one in configs({"odometry": "features"}).items()}
    plain, small = costs_of("room", frames, truth, localizers)
    assert (plain.settings, small.settings) == ("default", "pi")
    for cost in (plain, small):
        assert (cost.frames, cost.posed, cost.surfels) == (8, 8, None)
        assert cost.error_m is not None
        assert 0 < cost.error_m < 0.01
        assert cost.median_ms > 0


def test_the_profile_is_reported_as_a_share_of_the_default() -> None:
    plain = Cost("room", "default", 100, 90, 0.02, 40.0, 80.0, 30.0, 10, None)
    small = Cost("room", "pi", 100, 85, 0.03, 20.0, 60.0, 12.0, 5, None)
    assert ratio_sheet([plain, small]).rows == (("room", "0.50", "0.40", "1.50", "-5.0"),)


@pytest.mark.parametrize(("first_s", "met"), [(2.9, True), (3.1, False), (None, None)])
def test_a_first_pose_and_the_slowest_frame_are_held_against_the_issue(first_s: float | None, met: bool | None) -> None:
    pose, slowest = judge([("default", Followed(first_s, 90, 3, 30.0, 101.0, 50.0, 7, 1))])
    assert pose.is_met is met
    assert slowest.is_met is False
    assert np.isclose(slowest.measured or 0.0, 101.0)
