"""Verdict: who is left out, and what is said of it, by pieces of a drive whose fault is known."""

from __future__ import annotations

import numpy as np
import pytest

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.estimation import consistency_check
from wheelsight.estimation.agreement import RobotSensor
from wheelsight.estimation.consistency_check import MotionSegments, Verdict

WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0)
T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.0], [0, 0, 0, 1]])


def base_at(way_m: float) -> FloatArray:
    """T_odom_base (4, 4) on a bend to the left, a radian a metre."""
    return se3.from_plane(np.sin(way_m), 1 - np.cos(way_m), way_m)


def judged(way_m: float, turns: float, ratio: float | None = None) -> Verdict:
    """A drive, by a camera that shows `turns` times the turns; and the floor's height over that of the mount."""
    pieces = MotionSegments(WHEELS, T_BASE_CAMERA)
    verdict = Verdict()
    for at_m in np.arange(0, way_m, 0.02):
        mirrored = se3.from_plane(np.sin(at_m), turns * (1 - np.cos(at_m)), turns * at_m)
        if pieces.add(float(at_m), base_at(at_m), mirrored, lambda begin_s, end_s: None):
            if not verdict.judge(pieces.comparison, ratio):
                pieces.agree()
            if verdict.left_out is not None:
                break
    return verdict


def test_a_drive_that_both_tell_of_alike_is_agreed_on() -> None:
    verdict = judged(4.0, 1.0)
    assert verdict.has_agreed
    assert (verdict.found, verdict.is_sure, verdict.left_out, verdict.warnings) == ([], False, None, ())


@pytest.mark.parametrize(("setting", "value"), [("ENOUGH_M", 5.0), ("_ENOUGH_RAD", 5.0)])
def test_less_is_not_enough(setting: str, value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(consistency_check, setting, value)
    assert not judged(4.0, 1.0).has_agreed


def test_turns_the_other_way_are_the_fault_of_either() -> None:
    verdict = judged(2.0, -1.0)
    assert verdict.is_sure
    assert {one.sensor for one in verdict.found} == {RobotSensor.WHEELS, RobotSensor.CAMERA}
    assert verdict.left_out is None
    (warning,) = verdict.warnings
    assert warning.startswith("Wheels and camera contradict each other all along: either the wheels' fault (")


@pytest.mark.parametrize("settings", [{"_SURE_PIECES": 200}, {"_SURE_M": 9.0, "_SURE_RAD": 9.0}])
def test_it_is_sure_after_enough(settings: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in settings.items():
        monkeypatch.setattr(consistency_check, name, value)
    verdict = judged(2.0, -1.0)
    assert verdict.found
    assert not verdict.is_sure
    assert verdict.warnings == ()


def test_late_colour_and_a_camera_that_sees_nothing_are_left_out_with_their_cause() -> None:
    verdict = Verdict()
    verdict.leave_out_late_color(2)
    assert (verdict.left_out, verdict.is_sure) == (RobotSensor.CAMERA, True)
    assert "its colour images are 2 frames later than the depth" in verdict.warnings[0]
    verdict.leave_out_blind(0.2)
    assert "or the height in T_base_camera" in verdict.warnings[0]
