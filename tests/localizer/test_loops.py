"""Loops move the map under the robot: its pose in odom goes on as if nothing were, that in the map goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import synthetic
from grids import mostly_slow
from narrowing import not_none
from room_drive import make_room_drive

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.estimates import CameraEstimate, Estimate, MotionEstimate, PoseFinding, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import Event, RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.estimation.loop_updates import LoopClosureClient
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import KeyframePlace, OdometryKeyframe, PoseUpdate, Revisit
from wheelsight.slam.graph import RelativePose
from wheelsight.slam.loop_closing import LiveLoops
from wheelsight.slam.place_recognition import KnownMap

FAR = se3.exp([3.0, -2.0, 1.0, 0.4, -0.6, 0.8])
WAYS = {
    "dense": {"odometry": "dense", "dense.keyframe_way_m": 0.05},
    "map": {"odometry": "dense", "map": "surfels", "dense.keyframe_way_m": 0.05},
    "features": {"odometry": "features", "features.keyframe_share": 0.95},
    "wheels and dense": {"odometry": "wheels,dense", "dense.keyframe_way_m": 0.05},
    "wheels and features": {"odometry": "wheels,features", "features.keyframe_share": 0.95},
}


def in_map(beside: LoopClosureClient, found: Estimate) -> tuple[PoseFinding, FloatArray | None]:
    evidence = beside.update_evidence(
        found.stamp_s, found.status, found.T_odom_body, found.covariance, found.T_map_odom
    )
    return evidence.finding, evidence.covariance_map


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = tmp_path_factory.mktemp("recordings") / "room"
    make_room_drive(folder, frames=20)
    return open_recording(folder)


@pytest.fixture(scope="module")
def events(room: Recording) -> list[Event]:
    return list(room.events())


def answers(subject: Localizer, events: list[Event]) -> list[Estimate]:
    found = [(event, subject.process(event)) for event in events]
    return [answer for event, answer in found if isinstance(event, RgbdFrame) and answer is not None]


class Reported:
    """Stands in for the thread: shows once that the keyframes known by a time are FAR off."""

    def __init__(self, store: KeyframeStore, from_s: float) -> None:
        self.store, self.from_s, self.known = store, from_s, 0

    def due(self, stamp_s: float) -> PoseUpdate | None:
        if self.known or stamp_s < self.from_s:
            return None
        self.known = max(len(self.store) - 1, 1)  # the newest it has not heard of yet
        T = np.asarray(FAR @ self.store.T_map_keyframe[: self.known])
        return PoseUpdate(T, np.zeros(self.known, np.int64), np.zeros((0, 2), np.int64))


@pytest.mark.parametrize("way", mostly_slow(WAYS, quick=["map", "wheels and features"]))
def test_odom_does_not_jump_where_the_map_does(
    room: Recording, events: list[Event], way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = load_config(overrides={**WAYS[way], "loops.source": "keyframes"})
    still = Localizer(room.calibration, settings, waits=True)
    expected = answers(still, events)
    subject = Localizer(room.calibration, settings, waits=True)
    middle_s = events[0].stamp_s + 1.9  # it drives from 1.0 to 2.6 s
    reported = Reported(not_none(subject.keyframes), middle_s)
    monkeypatch.setattr(LiveLoops, "due", lambda live, stamp_s: reported.due(stamp_s))
    found = answers(subject, events)
    subject.close()
    still.close()
    assert reported.known
    for answer, as_before in list(zip(found, expected, strict=True))[1:]:  # beside wheels the first one begins nothing
        assert answer.status is as_before.status is Status.TRACKING
        T, T_before = not_none(answer.T_odom_body), not_none(as_before.T_odom_body)
        np.testing.assert_allclose(T, T_before, atol=2e-3)
        np.testing.assert_allclose(not_none(answer.covariance), not_none(as_before.covariance), rtol=0.2, atol=1e-5)
        T_map = not_none(answer.T_map_body)
        has_moved = answer.stamp_s >= middle_s
        # The filter's corrections move the map in both runs.
        T_map_before = not_none(as_before.T_map_body)
        np.testing.assert_allclose(T_map, (FAR if has_moved else np.eye(4)) @ T_map_before, atol=5e-3)
        # Who was where is remembered by keyframes, which all have moved by now.
        where = answer.pose_in(not_none(subject.keyframes))
        np.testing.assert_allclose(not_none(where), FAR @ T_map_before, atol=5e-3)
    np.testing.assert_allclose(subject.T_odom_map, se3.invert(found[-1].T_map_odom), atol=1e-9)


def test_who_does_not_ask_for_loops_has_none(room: Recording) -> None:
    for way in ("dense", "wheels and features"):
        assert Localizer(room.calibration, load_config(overrides=WAYS[way])).loops is None
    wheels = load_config(overrides={"odometry": "wheels", "loops.source": "keyframes"})
    assert Localizer(room.calibration, wheels).loops is None


@pytest.mark.parametrize(
    ("ends", "ties"),
    [
        ([], False),
        ([(0, 1), (0, 2), (3, 5)], False),  # on one side each
        ([(0, 3), (1, 3)], False),  # of one view
        ([(0, 3), (1, 4)], False),  # of two views side by side
        ([(0, 3), (1, 5)], True),
    ],
)
def test_loops_tie_keyframes_to_older_ones_where_they_are_seen_from_apart(
    monkeypatch: pytest.MonkeyPatch, ends: list[tuple[int, int]], ties: bool
) -> None:
    store, settings = KeyframeStore(), load_config(overrides={"loops.source": "keyframes"})
    blank = np.ones((24, 32), np.float32)
    for x_m in (0.0, 1.0, 2.0, 3.0, 3.1, 4.0):
        store.add(Keyframe.of_images(x_m, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), se3.from_plane(x_m, 0, 0))
    beside = LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, waits=True)
    loops = np.array(ends, np.int64).reshape(-1, 2)
    reported = PoseUpdate(np.array(store.T_map_keyframe), np.zeros(len(store), np.int64), loops)
    monkeypatch.setattr(LiveLoops, "due", lambda live, stamp_s: reported)
    assert not beside.has_loop_across(3)
    beside.move_keyframes(10.0, None)
    assert beside.has_loop_across(3) == ties
    beside.close()


def test_keyframes_are_handed_over_with_what_is_known_then_of_the_way_to_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of those kept before another filter took over, what was known when they were kept stands."""
    store, settings = KeyframeStore(), load_config(overrides={"loops.source": "keyframes"})
    beside = LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, waits=True)
    handed: list[OdometryKeyframe] = []
    monkeypatch.setattr(LiveLoops, "add", lambda live, lived: handed.append(lived))
    blank, C = np.ones((24, 32), np.float32), 1e-4 * np.eye(6)
    for x_m in (0.0, 1.0, 2.0):
        store.add(Keyframe.of_images(x_m, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), se3.from_plane(x_m, 0, 0))
        beside.add_keyframes(x_m, np.eye(4), C, None if x_m == 0 else (se3.from_plane(1, 0, x_m), C))
        assert not beside.has_new
    before = beside.has_pending, len(handed)
    beside.hand_over([None, (se3.from_plane(1, 0, 0.5), C)])
    assert before == (True, 0)
    assert not beside.has_pending
    assert [lived.number for lived in handed] == [0, 1, 2]
    assert handed[0].motion is None
    for lived, yaw_rad in zip(handed[1:], (1.0, 0.5), strict=True):
        np.testing.assert_array_equal(not_none(lived.motion)[0], se3.from_plane(1, 0, yaw_rad))
    beside.close()


@pytest.mark.parametrize(
    ("sigma_m", "sigma_rad", "is_sure"), [(0.1, 0.03, True), (0.3, 0.03, False), (0.1, 0.2, False), (None, None, False)]
)
def test_a_piece_counts_as_joined_once_it_is_sure_where_it_lies(
    monkeypatch: pytest.MonkeyPatch, sigma_m: float | None, sigma_rad: float | None, is_sure: bool
) -> None:
    store, settings = KeyframeStore(), load_config(overrides={"loops.source": "keyframes"})
    beside = LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, waits=True)
    blank = np.ones((24, 32), np.float32)
    for x_m in (0.0, 1.0):
        store.add(Keyframe.of_images(x_m, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), se3.from_plane(x_m, 0, 0))
    beside.begin_submap(KeyframeId(1))
    assert not beside.is_joined
    C_odom = 0.01 * np.eye(6)
    seen = Estimate(1.1, Status.TRACKING, se3.from_plane(1.5, 0, 0), C_odom + 1e-4 * np.eye(6))
    laid = PoseUpdate(FAR @ store.T_map_keyframe, np.zeros(2, np.int64), np.zeros((0, 2), np.int64))
    place = None
    if sigma_m is not None and sigma_rad is not None:
        C = np.diag(np.square([sigma_m] * 3 + [sigma_rad] * 3))
        T_map = FAR @ se3.from_plane(1.0, 0, 0)
        # Of the map's origin the left perturbation turns about; the keyframe is as uncertain as C says by itself.
        Ad = se3.adjoint(se3.from_parts(np.eye(3), T_map[:3, 3]))
        place = KeyframePlace(KeyframeId(1), se3.from_plane(1.0, 0, 0), C_odom, T_map, Ad @ C @ Ad.T, KeyframeId(1))

    def due(live: LiveLoops, stamp_s: float) -> PoseUpdate:
        live.place = place
        return laid

    monkeypatch.setattr(LiveLoops, "due", due)
    beside.move_keyframes(1.0, None)
    # As where somebody before the camera has led odometry astray since, and it says so.
    doubtful = replace(seen, covariance=C_odom + 0.1 * np.eye(6))
    assert in_map(beside, doubtful)[0] is PoseFinding.PLACE_UNCERTAIN
    found, covariance_map = in_map(beside, seen)
    assert beside.is_joined == is_sure
    assert found is (PoseFinding.PLACE_KNOWN if is_sure else PoseFinding.PLACE_UNCERTAIN)
    assert (covariance_map is not None) == is_sure
    if covariance_map is not None and sigma_m is not None:
        # 0.1 m at the keyframe, and what odometry has grown by since: 0.01 m, and little by turns at half a metre.
        C_now = se3.position_covariance(FAR @ se3.from_plane(1.5, 0, 0), covariance_map)
        assert np.sqrt(C_now.max()) == pytest.approx(sigma_m, rel=0.1)
    beside.close()


@pytest.mark.parametrize("grows", [False, True])
def test_in_a_map_that_stays_a_pose_is_tracked_while_it_is_sure(monkeypatch: pytest.MonkeyPatch, grows: bool) -> None:
    """Somebody before the camera leads odometry astray, and it says so; in a map that grows that is the way's doing."""
    store, settings = KeyframeStore(), load_config(overrides={"loops.source": "keyframes"})
    blank, C, places = np.ones((24, 32), np.float32), 1e-4 * np.eye(6), np.zeros((0, 2), np.int64)
    for x_m in (0.0, 1.0):
        store.add(Keyframe.of_images(x_m, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), se3.from_plane(x_m, 0, 0))
    step = RelativePose(KeyframeId(0), KeyframeId(1), se3.from_plane(1, 0, 0), C)
    known = KnownMap(store, Recognizer(), (step,) if grows else (), np.eye(4), 700 * C)
    beside = LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, known, waits=True)
    store.add(Keyframe.of_images(2.0, np.array([30.0, 30.0, 16.0, 12.0]), blank, blank), se3.from_plane(2, 0, 0))
    place = KeyframePlace(KeyframeId(2), np.eye(4), C, np.eye(4), C, KeyframeId(2))

    def due(live: LiveLoops, stamp_s: float) -> PoseUpdate:
        live.place, live.recognised_views = place, 2  # the start is confirmed
        return PoseUpdate(store.T_map_keyframe, np.zeros(3, np.int64), places)

    monkeypatch.setattr(LiveLoops, "due", due)
    beside.move_keyframes(2.0, None)
    sure = Estimate(2.1, Status.TRACKING, np.eye(4), 2 * C)
    # A start that a person gives is as uncertain as he is.
    answers = [replace(sure, covariance=C * of) for of in (700.0, 2.0, 30.0, 700.0, 2.0)]
    found = [in_map(beside, answer)[0] for answer in answers]
    assert found == [PoseFinding.PLACE_KNOWN] * 3 + [
        PoseFinding.PLACE_KNOWN if grows else PoseFinding.PLACE_UNCERTAIN,
        PoseFinding.PLACE_KNOWN,
    ]
    beside.close()


def test_a_keyframe_that_odometry_comes_back_to_is_reported_and_so_is_what_it_sees_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    store, settings = KeyframeStore(), load_config(overrides={"loops.source": "keyframes"})
    blank, C, T_odom_map = np.ones((24, 32), np.float32), 1e-4 * np.eye(6), se3.from_plane(0.0, 2.0, 0.5)
    added: list[OdometryKeyframe] = []
    again: list[Revisit] = []
    followed: list[Revisit] = []
    monkeypatch.setattr(LiveLoops, "add", lambda live, keyframe: added.append(keyframe))
    monkeypatch.setattr(LiveLoops, "request_place", lambda live, keyframe: again.append(keyframe))
    monkeypatch.setattr(LiveLoops, "add_revisit", lambda live, keyframe: followed.append(keyframe))
    beside = LoopClosureClient(store, Calibration.registered_camera(synthetic.CAMERA), settings, waits=True)

    def see(stamp_s: float, keyframe: int, apart_m: float = 0.0, *, is_new: bool = False) -> None:
        if is_new:
            images = np.array([30.0, 30.0, 16.0, 12.0]), blank, blank
            store.add(Keyframe.of_images(stamp_s, *images), se3.from_plane(float(keyframe), 0, 0))
        motion = MotionEstimate(np.eye(4), (1 + keyframe) * C)
        T, by = se3.from_plane(apart_m, 0.0, 0.0), KeyframeId(keyframe)
        seen = CameraEstimate(stamp_s, Status.TRACKING, np.eye(4), C, keyframe=by, T_keyframe_body=T, motion=motion)
        beside.add_tracked(seen, T_odom_map, 9 * C)
        beside.add_keyframes(stamp_s, T_odom_map, 9 * C)
        beside.hand_over()

    for number in range(3):
        see(float(number), number, is_new=True)
    see(3.0, 2)
    assert not again  # it is the newest, of which the thread is reported as that
    see(4.0, 0, 0.5)
    see(5.0, 0, 0.1)
    see(5.5, 0, 0.3)
    (found,) = again
    assert (found.number, found.stamp_s) == (0, 4.0)
    np.testing.assert_allclose(found.T_odom_keyframe, T_odom_map @ store.pose(KeyframeId(0)), atol=1e-12)
    np.testing.assert_array_equal(found.of_motion, C)
    assert not followed
    see(6.0, 3, is_new=True)
    assert [one.stamp_s for one in followed] == [5.0]  # of all frames by the first keyframe it was the nearest
    see(7.0, 3)
    see(8.0, 2)
    assert [one.number for one in again] == [0, 2]
    assert [keyframe.seen_from is None for keyframe in added] == [True, True, True, False]
    edge = not_none(added[-1].seen_from)
    assert (edge.first, edge.second, edge.is_loop) == (0, 3, True)
    np.testing.assert_allclose(edge.T_first_second, se3.from_plane(3.0, 0, 0), atol=1e-12)
    assert (np.diag(edge.covariance) > 4e-4).all()
