from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from area_drive import AREAS, BELIEVED_WHEELS, T_WORLD_START, area_drive, area_recording, by_areas, calibration
from narrowing import not_none
from places.made import trained
from stand_ins import CAMERA

from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import CalibrationError, ConfigError, PlaceError
from wheelsight.core.estimates import Estimate, Reason, Status
from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.estimation import Localizer, Places, RectifiedEstimate, load_places
from wheelsight.wheels import WheelOdometry
from wheelsight_papers import PaperRectifier

PLACES = Places(trained(), AREAS, T_WORLD_START)


def settings(**places: object) -> Config:
    given = {f"places.{name}": value for name, value in {"model": "three.places", **places}.items()}
    return load_config(overrides={"odometry": "wheels", **given})


def localizer(places: Places = PLACES, **given: object) -> Localizer:
    return Localizer(calibration(), settings(**given), places)


def driven(subject: Localizer, until: int = 60) -> Estimate:
    """The answer to the last of the drive's first events that is a reading."""
    answers = [subject.process(event) for event in area_drive().events[:until] if isinstance(event, WheelTicks)]
    assert answers[-1] is not None
    return answers[-1]


def test_it_shows_the_base_in_the_world_of_the_areas() -> None:
    subject = localizer()
    assert (subject.body, subject.frame) == ("base", "map")
    first = subject.process(area_drive().events[0])
    assert first is not None
    np.testing.assert_allclose(not_none(first.T_odom_body), T_WORLD_START, atol=1e-12)


@pytest.mark.parametrize("rectify", ["probabilistic", "paper"])
def test_without_a_frame_it_is_the_wheels_from_the_start(rectify: str) -> None:
    subject, wheels = localizer(rectify=rectify), WheelOdometry(BELIEVED_WHEELS)
    for event in area_drive().events[:200]:
        if isinstance(event, WheelTicks):
            estimate, alone = subject.process(event), wheels.process(event)
            assert estimate is not None
            assert alone.T_odom_body is not None
            np.testing.assert_allclose(not_none(estimate.T_odom_body), T_WORLD_START @ alone.T_odom_body, atol=1e-9)


def test_between_frames_the_covariance_grows() -> None:
    subject = localizer()
    sizes = []
    for event in area_drive().events[100:400]:
        if isinstance(event, WheelTicks):
            estimate = subject.process(event)
            assert estimate is not None
            assert estimate.covariance is not None
            sizes.append(np.linalg.det(estimate.covariance[np.ix_([0, 1, 5], [0, 1, 5])]))
    assert (np.diff(sizes) > 0).mean() > 0.99


@pytest.mark.parametrize(("rectify", "left"), [("probabilistic", 0.5), ("paper", 0.7)])
def test_areas_bring_wheels_nearer_to_the_truth(rectify: str, left: float) -> None:
    drive = area_drive()
    subject, alone = localizer(rectify=rectify), WheelOdometry(BELIEVED_WHEELS)
    errors, errors_alone = [], []
    for event in drive.events:
        estimate = subject.process(event)
        assert estimate is not None
        assert estimate.status is Status.TRACKING
        if isinstance(event, WheelTicks):
            T_odom_base = not_none(alone.process(event).T_odom_body)
            true_xy = drive.truth.at([event.stamp_s])[0, :2, 3]
            assert estimate.T_odom_body is not None
            errors.append(np.hypot(*(estimate.T_odom_body[:2, 3] - true_xy)))
            errors_alone.append(np.hypot(*((T_WORLD_START @ T_odom_base)[:2, 3] - true_xy)))
    assert np.mean(errors_alone) > 1
    assert np.mean(errors) < left * np.mean(errors_alone)


def test_the_papers_way_is_eq_5_with_the_weights_given() -> None:
    given: dict[str, Any] = {"rectify": "paper", "weights": "0.2,0.5,0.3", "odometry_term": "absolute"}
    subject, wheels = localizer(**given), WheelOdometry(BELIEVED_WHEELS)
    weights = settings(**given).places.weights
    assert weights is not None
    eq5, T_before = PaperRectifier(AREAS, T_WORLD_START, weights.as_weights(), "absolute"), np.eye(4)
    for event in area_drive().events[:300]:
        estimate = subject.process(event)
        if isinstance(event, WheelTicks):
            T_odom_base = wheels.process(event).T_odom_body
            assert T_odom_base is not None
            eq5.predict(se3.invert(T_before) @ T_odom_base)
            T_before = T_odom_base
            expected = eq5.estimate(event.stamp_s)
            assert estimate is not None
            np.testing.assert_allclose(not_none(estimate.T_odom_body), not_none(expected.T_odom_body), atol=1e-12)
        elif isinstance(event, RgbdFrame):
            eq5.update(event.stamp_s, trained().predict(event).area_index)


def test_a_frame_is_answered_where_the_robot_is_by_then() -> None:
    subject = localizer()
    reading = driven(subject)
    speed, _ = subject.odometry.twist  # type: ignore[union-attr,misc]
    assert speed > 0.9
    frame = replace(area_drive().frames[0], stamp_s=reading.stamp_s + 0.1)
    estimate = subject.process(frame)
    assert estimate is not None
    assert estimate.T_odom_body is not None
    assert reading.T_odom_body is not None
    gone = se3.invert(reading.T_odom_body) @ estimate.T_odom_body
    assert gone[0, 3] == pytest.approx(0.1 * speed, rel=0.1)


def test_what_the_model_says_is_handed_on() -> None:
    subject = localizer()
    driven(subject)
    frame = replace(area_drive().frames[0], stamp_s=area_drive().events[60].stamp_s)
    estimate = subject.process(frame)
    assert subject.last_place is not None
    np.testing.assert_array_equal(subject.last_place.probabilities, trained().predict(frame).probabilities)
    assert isinstance(estimate, RectifiedEstimate)
    assert estimate.area_probabilities is not None
    assert set(subject.stage_seconds) == {"check", "name the area", "rectify", "decide"}
    assert subject.last_matches is None


@pytest.mark.parametrize("rectify", ["probabilistic", "paper"])
@pytest.mark.parametrize("kind", ["skipped", "without depth", "late"])
def test_a_frame_that_measures_nothing_moves_nothing_and_says_why(rectify: str, kind: str) -> None:
    subject = localizer(rectify=rectify)
    before = driven(subject)
    whole = area_drive().frames[0]
    given: RgbdFrame | SkippedFrame = replace(whole, stamp_s=before.stamp_s, depth_m=np.zeros_like(whole.depth_m))
    why = "no measurement: the frame has no depth"
    if kind == "skipped":
        given, why = SkippedFrame(before.stamp_s, "depth/1.png is cut off"), "no measurement: depth/1.png is cut off"
    if kind == "late":
        subject.process(given)
        given, why = replace(whole, stamp_s=before.stamp_s), "no measurement: its stamp does not come after "
    estimate = subject.process(given)
    assert estimate is not None
    assert subject.note.startswith(why)
    if kind == "late":
        assert estimate.reason is Reason.FRAME_UNUSABLE
        return
    assert (estimate.status, estimate.reason) == (Status.TRACKING, None)
    if rectify == "probabilistic":  # eq. 5 weighs the last coordinate at every frame
        np.testing.assert_allclose(not_none(estimate.T_odom_body), not_none(before.T_odom_body), atol=1e-9)


def test_a_frame_long_after_the_last_reading_has_no_pose() -> None:
    subject = localizer()
    before = driven(subject)
    estimate = subject.process(replace(area_drive().frames[0], stamp_s=before.stamp_s + 0.6))
    assert estimate is not None
    assert (estimate.status, estimate.reason) == (Status.FAILING, Reason.GAP)
    assert subject.note == "the last wheel reading is 0.600 s old"
    assert subject.last_place is None


def test_before_the_start_is_known_there_is_no_pose() -> None:
    events = area_drive().events
    subject = localizer(replace(PLACES, begin_s=events[30].stamp_s))
    early = [subject.process(event) for event in events[:30]]
    assert all(estimate is not None and estimate.T_odom_body is None for estimate in early)
    assert {estimate.status for estimate in early if estimate is not None} == {Status.INITIALIZING}
    first = subject.process(next(event for event in events[30:] if isinstance(event, WheelTicks)))
    assert first is not None
    np.testing.assert_allclose(not_none(first.T_odom_body), T_WORLD_START, atol=1e-12)


def test_a_refused_reading_is_refused_here_too() -> None:
    subject = localizer()
    before = driven(subject)
    estimate = subject.process(WheelTicks(before.stamp_s + 0.02, 10**7, 10**7))
    assert estimate is not None
    assert (estimate.status, estimate.reason) == (Status.FAILING, Reason.IMPLAUSIBLE_MOTION)
    np.testing.assert_allclose(not_none(estimate.T_odom_body), not_none(before.T_odom_body), atol=1e-9)


def test_a_frame_of_another_size_is_refused_by_its_number() -> None:
    subject = localizer()
    before = driven(subject)
    frame = area_drive().frames[3]
    smaller = replace(frame, stamp_s=before.stamp_s, color=frame.color[::2, ::2], depth_m=frame.depth_m[::2, ::2])
    with pytest.raises(PlaceError, match=r"^frame 3 at .* is 16x12 with depth 16x12; the model was trained on 32x24"):
        subject.process(smaller)


def test_areas_and_start_may_all_stand_in_the_settings(tmp_path: Path) -> None:
    area_recording(tmp_path)
    config = by_areas(tmp_path, areas=str(tmp_path / "areas.yaml"), start="0.5,0,0")
    first = Localizer(calibration(), config).process(area_drive().events[0])
    assert first is not None
    np.testing.assert_allclose(not_none(first.T_odom_body), T_WORLD_START, atol=1e-12)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    area_recording(tmp_path)
    with pytest.raises(ConfigError, match="no model of places is given"):
        load_places(Config().places)
    with pytest.raises(ConfigError, match="no areas are given"):
        Localizer(calibration(), by_areas(tmp_path))
    with pytest.raises(ConfigError, match=r"where the robot starts .* is not known .give --start X,Y,YAW_DEG."):
        Localizer(calibration(), by_areas(tmp_path, areas=str(tmp_path / "areas.yaml")))


def test_wheels_are_needed() -> None:
    with pytest.raises(CalibrationError, match="has no wheels"):
        Localizer(Calibration.registered_camera(CAMERA), settings(), PLACES)
