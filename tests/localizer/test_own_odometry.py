"""A visual odometry of a user's own follows the camera, alone and beside wheels; what it fails at gives no pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from room_drive import make_room_drive

from wheelsight import Config, Localizer, MotionEstimate, Reason, RgbdFrame, Status, load_config, run
from wheelsight.app.run import RealTimeRecording
from wheelsight.core.errors import ArgumentError, ConfigError, PartError
from wheelsight.core.estimates import Estimate
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId
from wheelsight.core.messages import Event
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.vision.visual_odometry import OwnOdometry

SIGMAS = np.array([2e-3] * 3 + [1e-3] * 3)
ALONE = Config(odometry=("own",))
Room = tuple[Recording, list[Event], Trajectory]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    """A drive of 20 frames between two halts: recording, events, and the true way of the base since the begin."""
    folder = tmp_path_factory.mktemp("recordings") / "room"
    truth = make_room_drive(folder, frames=20)
    recording = open_recording(folder)
    return recording, list(recording.events()), replace_frame(truth)


def replace_frame(truth: Trajectory) -> Trajectory:
    return Trajectory(truth.stamps_s, se3.invert(truth.T_frame_body[0]) @ truth.T_frame_body, body="base")


class Reported:
    """Knows the true motion of the camera, and errs by noise; `change` makes something else of an answer."""

    def __init__(
        self, room: Room, change: Callable[[float, MotionEstimate], Any] = lambda stamp_s, found: found
    ) -> None:
        recording, events, self._truth = room
        self._T_base_camera, self._change = not_none(recording.calibration.T_base_camera), change
        self._rng, self._begin_s = np.random.default_rng(3), events[0].stamp_s
        self.priors: list[FloatArray | None] = []
        self.errors_m: list[float] = []

    def T_odom_camera(self, frame: RgbdFrame) -> FloatArray:
        at = np.clip(frame.stamp_s, *self._truth.stamps_s[[0, -1]])
        return np.asarray(self._truth.at([at])[0] @ self._T_base_camera)

    def align(self, reference: RgbdFrame, current: RgbdFrame, T_reference_current_prior: FloatArray | None) -> Any:
        truth = se3.invert(self.T_odom_camera(reference)) @ self.T_odom_camera(current)
        self.priors.append(T_reference_current_prior)
        if T_reference_current_prior is not None:
            self.errors_m.append(float(np.linalg.norm((T_reference_current_prior - truth)[:3, 3])))
        found = MotionEstimate(se3.exp(self._rng.normal(0, SIGMAS)) @ truth, np.diag(SIGMAS**2), None, 50, 40)
        return self._change(current.stamp_s - self._begin_s, found)


def answers(subject: Localizer, events: list[Event]) -> list[tuple[RgbdFrame, Estimate]]:
    found = [(event, subject.process(event)) for event in events]
    return [(event, not_none(answer)) for event, answer in found if isinstance(event, RgbdFrame)]


def off_m(answer: Estimate, truth: Trajectory) -> float:
    at = np.clip(answer.stamp_s, *truth.stamps_s[[0, -1]])
    return float(np.linalg.norm((not_none(answer.T_map_body) - truth.at([at])[0])[:3, 3]))


@pytest.mark.parametrize("config", [Config(), ALONE], ids=["joined", "alone"])
def test_it_follows_the_camera_with_an_honest_covariance(room: Room, config: Config) -> None:
    recording, events, truth = room
    part = Reported(room)
    with Localizer(recording.calibration, config, visual_odometry=part) as subject:
        found = answers(subject, events)
        assert isinstance(subject.odometry, OwnOdometry)
        assert len(not_none(subject.keyframes)) > 1
    assert {answer.status for _, answer in found[1:]} == {Status.TRACKING}
    T_first = truth.at([np.clip(found[0][1].stamp_s, truth.stamps_s[0], None)])[0]
    np.testing.assert_allclose(T_first, np.eye(4), atol=1e-6)
    for _, answer in found[1:]:
        sigma_m = np.sqrt(np.trace(se3.position_covariance(not_none(answer.T_odom_body), not_none(answer.covariance))))
        assert off_m(answer, truth) < 3 * sigma_m + 1e-3
        assert sigma_m < 0.05
    assert off_m(found[-1][1], truth) < 0.02
    if config is ALONE:
        assert set(map(type, part.priors)) == {type(None)}
        assert subject.warnings == ("Wheel readings are not used: --odometry own leaves them out.",)
    else:
        assert subject.warnings == ()
        assert max(part.errors_m) < 0.02  # wheels tell the part what to expect


FAR = se3.exp([9.0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda found: MotionEstimate.failed(Reason.TOO_FEW_MATCHES), Reason.TOO_FEW_MATCHES),
        (lambda found: MotionEstimate(None, None), Reason.INVALID),
        (lambda found: replace(found, T_reference_current=np.full((4, 4), np.nan)), Reason.INVALID),
        (lambda found: replace(found, covariance=np.full((6, 6), np.nan)), Reason.INVALID),
        (lambda found: replace(found, covariance=np.full((6, 6), np.inf)), Reason.INVALID),
        (lambda found: replace(found, T_reference_current=FAR), Reason.IMPLAUSIBLE_MOTION),
        (lambda found: replace(found, reason=Reason.POOR_FIT), Reason.POOR_FIT),
    ],
)
def test_what_is_no_motion_is_a_lost_frame_and_wheels_carry_the_pose_on(
    room: Room, change: Callable[[MotionEstimate], Any], reason: Reason
) -> None:
    recording, events, truth = room

    def changed(stamp_s: float, found: MotionEstimate) -> Any:
        return change(found) if 1.2 < stamp_s < 2.2 else found

    settings = load_config(overrides={"features.lost_after": 5, "odometry": "own"})
    with Localizer(recording.calibration, settings, visual_odometry=Reported(room, changed)) as subject:
        alone = [answer for _, answer in answers(subject, events)]
    begin_s = events[0].stamp_s
    dark = [answer for answer in alone if 1.2 < answer.stamp_s - begin_s < 2.2]
    assert {answer.reason for answer in dark} == {reason}
    assert all(answer.T_odom_body is None for answer in dark)
    assert [answer.status for answer in dark] == [Status.FAILING] * 4 + [Status.LOST] * (len(dark) - 4)
    after = alone[alone.index(dark[-1]) + 1 :]
    assert {answer.status for answer in after} == {Status.TRACKING}
    assert off_m(alone[-1], truth) < 0.02
    with Localizer(recording.calibration, visual_odometry=Reported(room, changed)) as subject:
        joined = [answer for _, answer in answers(subject, events)]
    dark = [answer for answer in joined if 1.2 < answer.stamp_s - begin_s < 2.2]
    assert Status.COASTING in {answer.status for answer in dark}
    assert max(off_m(answer, truth) for answer in joined) < 0.05


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda found: 1 / 0, "Reported.align raised ZeroDivisionError: division by zero"),
        (lambda found: None, "Reported.align returned NoneType, not a MotionEstimate"),
        (lambda found: found.T_reference_current, "Reported.align returned ndarray, not a MotionEstimate"),
        (lambda found: replace(found, T_reference_current=np.eye(3)), r"T_reference_current is of shape \(3, 3\)"),
        (lambda found: replace(found, T_reference_current=2 * np.eye(4)), "T_reference_current is not a rigid motion"),
        (lambda found: replace(found, covariance=None), "a motion without a covariance"),
        (lambda found: replace(found, covariance=np.eye(3)), r"covariance is of shape \(3, 3\), not \(6, 6\)"),
        (lambda found: replace(found, covariance=np.zeros((6, 6))), "the covariance is not positive definite"),
        (lambda found: replace(found, covariance=-np.eye(6)), "the covariance is not positive definite"),
        (lambda found: replace(found, covariance=np.triu(np.ones((6, 6)))), "the covariance is not positive definite"),
        (lambda found: replace(found, degenerate=np.ones((2, 3))), r"degenerate is of shape \(2, 3\)"),
    ],
)
def test_a_mistake_of_the_part_is_one_typed_error(
    room: Room, change: Callable[[MotionEstimate], Any], why: str
) -> None:
    recording, events, _ = room
    part = Reported(room, lambda stamp_s, found: change(found))
    with (
        Localizer(recording.calibration, ALONE, visual_odometry=part) as subject,
        pytest.raises(PartError, match=why) as reported,
    ):
        answers(subject, events[:20])
    assert "\n" not in str(reported.value)


def test_the_cause_of_an_error_of_the_part_is_kept(room: Room) -> None:
    recording, events, _ = room
    part = Reported(room, lambda stamp_s, found: 1 / 0)
    with Localizer(recording.calibration, visual_odometry=part) as subject, pytest.raises(PartError) as reported:
        answers(subject, events)
    assert isinstance(reported.value.__cause__, ZeroDivisionError)


@pytest.mark.slow
def test_a_run_follows_it_and_writes_what_was_tracked_before_an_error(room: Room, tmp_path: Path) -> None:
    recording = room[0]
    record = run(recording, Config(), tmp_path / "whole", visual_odometry=Reported(room))
    assert record.odometry == "joined"
    assert not_none(record.evaluation).ate.translation.rmse < 0.005
    assert {path.name for path in (tmp_path / "whole").iterdir()} >= {"joined", "own", "wheels", "report.html"}
    assert load_config(tmp_path / "whole" / "config.yaml").odometry == ("wheels", "own")

    def breaks(stamp_s: float, found: MotionEstimate) -> Any:
        return found if stamp_s < 2.0 else 1 / 0

    with pytest.raises(PartError, match="ZeroDivisionError"):
        run(recording, ALONE, tmp_path / "half", visual_odometry=Reported(room, breaks))
    lines = (tmp_path / "half" / "trajectory.txt").read_text().splitlines()
    assert 20 < len([line for line in lines if not line.startswith("#")]) < len(record.frames)


def test_it_is_joined_by_the_filter_of_ligocki_too(room: Room) -> None:
    recording, events, truth = room
    settings = load_config(overrides={"odometry": "wheels,own", "fusion.filter": "ligocki"})
    with Localizer(recording.calibration, settings, visual_odometry=Reported(room)) as subject:
        found = answers(subject, events)
    assert found[-1][1].status is Status.TRACKING
    assert off_m(found[-1][1], truth) < 0.05


@pytest.mark.parametrize(
    ("overrides", "parts", "why"),
    [
        ({"odometry": "own"}, {}, "odometry own is a part of your own"),
        (
            {"odometry": "wheels,dense"},
            {"visual_odometry": 1},
            "visual_odometry is not used: odometry is wheels, dense",
        ),
        ({"odometry": "wheels"}, {"loop_detector": 1}, "loop_detector is not used: no camera keeps keyframes"),
        ({"loops.source": "matches"}, {"loop_detector": 1}, "loop_detector is not used: loops.source is matches"),
        ({"map": "surfels"}, {"visual_odometry": 1}, "map is built by dense odometry"),
    ],
)
def test_parts_without_a_use_are_refused(
    room: Room, overrides: dict[str, Any], parts: dict[str, Any], why: str
) -> None:
    class Both(Reported):
        def candidates(self, number: Any, keyframe: Any) -> list[int]:
            return []

    given: dict[str, Any] = {name: Both(room) for name in parts}
    with pytest.raises(ConfigError, match=why):
        Localizer(room[0].calibration, load_config(overrides=overrides), **given)


def test_what_is_no_part_is_refused(room: Room) -> None:
    with pytest.raises(ArgumentError, match="visual_odometry is the class Reported, not an object with a method align"):
        Localizer(room[0].calibration, visual_odometry=Reported)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="loop_detector is a Reported, not an object with a method candidates"):
        Localizer(room[0].calibration, loop_detector=Reported(room))  # type: ignore[arg-type]


class Earlier:
    """A loop detector to which all earlier keyframes look alike."""

    def __init__(self) -> None:
        self.shown: list[int] = []

    def candidates(self, number: KeyframeId, keyframe: Keyframe) -> list[int]:
        self.shown.append(number)
        return [one for one in self.shown if one < number]


@pytest.mark.slow
def test_it_finds_itself_in_a_known_map_by_a_detector_of_a_users_own(room: Room, tmp_path: Path) -> None:
    recording, events, truth = room
    run(recording, load_config(overrides={"map": "surfels", "loops.source": "keyframes"}), tmp_path / "one")
    known = {"known_map.path": str(tmp_path / "one"), "loops.apart_s": 0.5, "loops.latency_s": 0.1}
    part, detector = Reported(room), Earlier()
    record = run(
        recording, load_config(overrides=known), tmp_path / "two", visual_odometry=part, loop_detector=detector
    )
    assert detector.shown == list(range(len(detector.shown)))
    found = not_none(record.known_map)
    T = truth.at([np.clip(events[0].stamp_s + not_none(found.after_s), *truth.stamps_s[[0, -1]])])[0]
    assert (found.x_m, found.y_m) == pytest.approx(T[:2, 3], abs=0.05)
    assert found.keyframes_placed == found.keyframes


@pytest.mark.slow
def test_it_is_played_in_real_time_and_is_not_shown_the_frames_of_the_rehearsal(room: Room, tmp_path: Path) -> None:
    recording, events, _ = room
    part = Reported(room)
    record = run(RealTimeRecording(recording), Config(), tmp_path / "out", visual_odometry=part)
    assert record.odometry == "joined"
    frames = sum(isinstance(event, RgbdFrame) for event in events)
    assert 0 < len(part.priors) < 3 * frames  # by the joined track alone
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"joined", "wheels"}
    assert not (tmp_path / "out" / "own").exists()
