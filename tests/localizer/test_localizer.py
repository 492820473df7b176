from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from stand_ins import CAMERA, TrueOdometry, frame

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import WHEEL_READINGS, SkippedFrame, WheelTicks, YawRate
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.vision.dense import DenseOdometry
from wheelsight.wheels import WheelOdometry


@pytest.fixture(autouse=True)
def truth(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> Trajectory:
    motions = se3.exp(0.1 * rng.standard_normal((10, 6)))
    TrueOdometry.truth = Trajectory(np.arange(10.0), motions)
    monkeypatch.setattr("wheelsight.estimation.camera_localizer.FeatureOdometry", TrueOdometry)
    return TrueOdometry.truth


def localizer(T_base_camera: np.ndarray | None = None) -> Localizer:
    by_features = load_config(overrides={"odometry": "features"})
    return Localizer(Calibration.registered_camera(CAMERA, T_base_camera=T_base_camera), by_features)


def test_wheel_readings_say_nothing_about_a_frame() -> None:
    assert localizer().process(WheelTicks(0.0, 1, 2)) is None


def test_events_that_are_not_used_are_warned_of_once(caplog: pytest.LogCaptureFixture) -> None:
    subject = localizer()
    for stamp_s in (0.0, 0.1, 0.2):
        assert subject.process(WheelTicks(stamp_s, 1, 2)) is None
        assert subject.process(YawRate(stamp_s, 0.0)) is None
    reported = (
        "Wheel readings are not used: the calibration has no wheels (give them by --calibration).",
        "Readings of the gyroscope are not used: they go with wheels.",
    )
    assert subject.warnings == reported
    assert tuple(record.message for record in caplog.records if record.levelname == "WARNING") == reported


@pytest.mark.parametrize(
    ("given", "body", "frame_name", "unused"),
    [
        ({"T_base_camera": np.eye(4), "wheels": Wheels(0.17, 0.17, 0.52, 3200.0)}, "base", "map", None),
        ({"wheels": Wheels(0.17, 0.17, 0.52, 3200.0)}, "camera", "map", "the calibration has no T_base_camera"),
        ({"T_base_camera": np.eye(4)}, "base", "map", "the calibration has no wheels (give them by --calibration)"),
    ],
)
def test_without_a_name_all_sensors_that_go_together_are_joined(
    given: dict[str, Any], body: str, frame_name: str, unused: str | None
) -> None:
    subject = Localizer(Calibration.registered_camera(CAMERA, **given))
    assert (subject.body, subject.frame) == (body, frame_name)
    assert isinstance(subject.odometry, DenseOdometry)
    assert (WheelTicks in subject.answers) == (unused is None)
    subject.process(WheelTicks(0.0, 1, 2))
    assert [reported.startswith(f"Wheel readings are not used: {unused}") for reported in subject.warnings] == (
        [] if unused is None else [True]
    )


def test_wheels_alone_are_followed_where_there_is_no_camera() -> None:
    assert Localizer(Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200.0))).answers == WHEEL_READINGS


def test_a_frame_is_answered_by_odometry(truth: Trajectory) -> None:
    estimate = localizer().process(frame(3, 3.0))
    assert estimate is not None
    assert estimate.body == "camera"
    np.testing.assert_allclose(not_none(estimate.T_odom_body), truth.T_frame_body[3])


def test_a_skipped_frame_gets_no_pose_and_says_why() -> None:
    subject = localizer()
    estimate = subject.process(SkippedFrame(0.0, "depth/0.png is truncated"))
    assert estimate is not None
    assert estimate.T_odom_body is None
    assert estimate.reason is Reason.FRAME_UNUSABLE
    assert estimate.status is Status.INITIALIZING
    assert subject.note == "depth/0.png is truncated"


def test_a_skipped_frame_is_not_called_tracked() -> None:
    subject = localizer()
    subject.process(frame(0, 0.0))
    skipped = subject.process(SkippedFrame(1.0, "unreadable"))
    assert skipped is not None
    assert skipped.status is Status.FAILING
    tracked = subject.process(frame(2, 2.0))
    assert tracked is not None
    assert tracked.status is Status.TRACKING
    assert subject.note == ""


NOTE_OF_LEAP = "the clock of the camera leaps by -1 s"


@pytest.mark.parametrize("late_s", [5.0, 4.0])
def test_a_frame_that_is_not_newer_is_refused_with_the_reason_said(late_s: float) -> None:
    subject = localizer()
    subject.process(frame(0, 5.0))
    estimate = subject.process(frame(1, late_s))
    assert estimate is not None
    assert estimate.T_odom_body is None
    assert estimate.reason is Reason.FRAME_UNUSABLE
    assert subject.note == ("its stamp does not come after 5.000000 s" if late_s == 5 else NOTE_OF_LEAP)
    assert len(TrueOdometry.seen) == 1
    newer = subject.process(frame(2, 6.0))
    assert newer is not None
    assert newer.status is Status.TRACKING


@pytest.mark.parametrize("stamp_s", [np.nan, np.inf])
def test_a_frame_whose_stamp_is_no_number_is_refused_and_those_after_it_are_not(stamp_s: float) -> None:
    subject = localizer()
    subject.process(frame(0, 5.0))
    odd = subject.process(frame(1, stamp_s))
    assert odd is not None
    assert (odd.T_odom_body, odd.reason) == (None, Reason.FRAME_UNUSABLE)
    newer = subject.process(frame(2, 6.0))
    assert newer is not None
    assert newer.status is Status.TRACKING


def test_poses_of_the_base_start_where_the_base_was(truth: Trajectory, rng: np.random.Generator) -> None:
    T_base_camera = se3.exp(rng.standard_normal(6))
    estimate = localizer(T_base_camera).process(frame(3, 3.0))
    assert estimate is not None
    assert estimate.body == "base"
    T_start_base, T_camera0_camera = estimate.T_odom_body, truth.T_frame_body[3]
    # A point fixed to the base, seen by either way round.
    p_camera = rng.standard_normal(3)
    p_base = se3.apply(T_base_camera, p_camera)
    by_camera = se3.apply(T_base_camera, se3.apply(T_camera0_camera, p_camera))
    np.testing.assert_allclose(se3.apply(not_none(T_start_base), p_base), by_camera, atol=1e-12)


def test_covariance_of_the_base_moves_as_the_pose_does(truth: Trajectory, rng: np.random.Generator) -> None:
    T_base_camera = se3.exp(rng.standard_normal(6))
    estimate = localizer(T_base_camera).process(frame(3, 3.0))
    assert estimate is not None
    assert estimate.T_odom_body is not None
    T_camera_base = se3.invert(T_base_camera)
    J = np.empty((6, 6))  # of the base's perturbation by the camera's, measured
    for axis in range(6):
        xi = np.zeros(6)
        xi[axis] = 1e-6
        moved = T_base_camera @ se3.exp(xi) @ truth.T_frame_body[3] @ T_camera_base
        J[:, axis] = se3.log(moved @ se3.invert(estimate.T_odom_body)) / 1e-6
    np.testing.assert_allclose(not_none(estimate.covariance), J @ (1e-6 * np.eye(6)) @ J.T, rtol=1e-5, atol=1e-12)


def test_a_failing_frame_of_a_robot_with_a_base_is_still_of_the_base() -> None:
    estimate = localizer(np.eye(4)).process(frame(3, 3.0, dark=True))
    assert estimate is not None
    assert (estimate.body, estimate.T_odom_body) == ("base", None)


WHEELS = Wheels(0.17, 0.17, 0.52, 3200.0, slip_m_per_sqrt_m=0.02)


def wheeled(**settings: object) -> Localizer:
    overrides = {"odometry": "wheels"} | {f"wheels.{name}": value for name, value in settings.items()}
    return Localizer(Calibration(wheels=WHEELS), load_config(overrides=overrides))


def test_wheels_answer_readings_of_wheels_alone() -> None:
    subject = wheeled()
    assert (subject.body, subject.frame) == ("base", "odom")
    assert subject.process(frame(0, 0.0)) is None
    assert subject.process(SkippedFrame(0.0, "cut off")) is None
    subject.process(WheelTicks(0.0, 0, 0))
    estimate = subject.process(WheelTicks(0.02, 100, 100))
    assert estimate is not None
    assert estimate.T_odom_body is not None
    assert estimate.T_odom_body[0, 3] == pytest.approx(100 * WHEELS.left_m_per_tick)
    assert (subject.last_matches, subject.stage_seconds) == (None, {})


def test_the_integration_is_as_set() -> None:
    for integration in ("arc", "midpoint", "euler"):
        subject, expected = wheeled(integration=integration), WheelOdometry(WHEELS, integration)
        for reading in (WheelTicks(0.0, 0, 0), WheelTicks(0.02, 20, 90), WheelTicks(0.04, 50, 200)):
            estimate, wanted = subject.process(reading), expected.process(reading)
            assert estimate is not None
            np.testing.assert_array_equal(estimate.T_odom_body, wanted.T_odom_body)


@pytest.mark.parametrize("gyro", [True, False])
def test_the_gyroscope_turns_the_robot_where_it_is_wanted(gyro: bool) -> None:
    """Of wheels that turn a tenth more than they say, after a rest."""
    subject, turned, ticks_a_rad = wheeled(gyro=gyro), 0.0, WHEELS.track_width_m / WHEELS.left_m_per_tick / 2
    for i in range(800):
        rate = 0.0 if i < 150 else 0.5
        turned += 0.02 * rate
        subject.process(YawRate(0.02 * i, 1.1 * rate))
        estimate = subject.process(WheelTicks(0.02 * i, -round(ticks_a_rad * turned), round(ticks_a_rad * turned)))
    assert estimate is not None
    assert estimate.T_odom_body is not None
    yaw = np.arctan2(estimate.T_odom_body[1, 0], estimate.T_odom_body[0, 0])
    off = (yaw - turned * (1.1 if gyro else 1.0) + np.pi) % (2 * np.pi) - np.pi
    assert abs(off) < (0.02 if gyro else 1e-3)
    assert subject.note == ""
    assert subject.warnings == (() if gyro else ("Readings of the gyroscope are not used: --no-gyro leaves them out.",))


def test_what_the_odometry_needs_the_calibration_must_have() -> None:
    with pytest.raises(CalibrationError, match=r"has no wheels .*--calibration"):
        Localizer(Calibration.registered_camera(CAMERA), load_config(overrides={"odometry": "wheels"}))


def test_a_localizer_goes_by_one_odometry() -> None:
    both = load_config(overrides={"odometry": "wheels,features", "fusion": "none"})
    with pytest.raises(ConfigError, match=r"not wheels and features .*alone"):
        Localizer(Calibration.registered_camera(CAMERA, wheels=WHEELS), both)
    assert Localizer(Calibration.registered_camera(CAMERA, wheels=WHEELS), both.alone("wheels")).frame == "odom"


def test_dense_odometry_answers_frames_as_features_do(monkeypatch: pytest.MonkeyPatch, truth: Trajectory) -> None:
    made: list[object] = []

    class Dense(TrueOdometry):
        def __init__(
            self, calibration: Calibration, settings: object, T_map_first: object = None, store: object = None
        ) -> None:
            super().__init__(calibration, settings)
            made.append(settings)

    monkeypatch.setattr("wheelsight.estimation.camera_localizer.DenseOdometry", Dense)
    config = load_config(overrides={"odometry": "dense", "dense.lost_after": 5})
    subject = Localizer(Calibration.registered_camera(CAMERA), config)
    assert made == [config.dense]
    subject.process(frame(2, 2.0))
    estimate = subject.process(frame(3, 3.0))
    assert estimate is not None
    np.testing.assert_allclose(not_none(estimate.T_odom_body), truth.T_frame_body[3])
    assert (subject.body, subject.frame) == ("camera", "map")
