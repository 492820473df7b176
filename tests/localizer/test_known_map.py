"""A drive in a map of before: no one says where it begins, until the place is recognised from two views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from grids import mostly_slow
from narrowing import not_none
from places.seen_room import frame_at, standing
from synthetic import CAMERA

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.keyframes import KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.estimation import Localizer
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.place_recognition import KnownMap

RATE_HZ, STEP_RAD = 15.0, np.radians(4.0)
CALIBRATION = Calibration.registered_camera(CAMERA)
SETTINGS = {"odometry": "dense", "loops.source": "keyframes", "loops.latency_s": 0.3, "loops.apart_s": 2.5}


def at(step: float, aside_m: float = 0.0) -> FloatArray:
    """T_room_camera (4, 4): it turns in the middle of the room."""
    return standing(0.1 * np.sin(0.2 * step) - 0.5, aside_m, STEP_RAD * step)


def frames(T_room_camera: list[FloatArray], begin_s: float, seed: int = 0) -> list[RgbdFrame]:
    return [frame_at(T, seed=seed, stamp_s=begin_s + k / RATE_HZ) for k, T in enumerate(T_room_camera)]


FIRST_DAY = [at(step) for step in range(60)]
SECOND_DAY = [at(step, 0.15) for step in range(50, 20, -1)]


@pytest.fixture(scope="module")
def before() -> tuple[Localizer, KnownMap]:
    subject = Localizer(CALIBRATION, load_config(overrides=SETTINGS), waits=True)
    for frame in frames(FIRST_DAY, 100.0):
        subject.process(frame)
    loops = not_none(subject.loops)
    closed = loops.finish()
    subject.close()
    return subject, KnownMap(not_none(subject.keyframes), loops.recognizer, closed.edges)


def known(before: tuple[Localizer, KnownMap], *, extends: bool = False) -> KnownMap:
    """The same map again: what one drive adds, another does not know."""
    store, given = KeyframeStore(), before[1]
    for number in map(KeyframeId, range(len(given.recognizer))):
        store.add(given.store[number], given.store.T_map_keyframe[number])
    recognizer = type(given.recognizer)()
    for number in store:
        recognizer.add(number, store[number])
    return KnownMap(store, recognizer, given.edges if extends else ())


def drive(known: KnownMap, seen: list[RgbdFrame]) -> tuple[Localizer, list[Estimate]]:
    subject = Localizer(CALIBRATION, load_config(overrides=SETTINGS), known=known, waits=True)
    return subject, [not_none(subject.process(frame)) for frame in seen]


def off(T: FloatArray | None, T_room_camera: FloatArray) -> tuple[float, float]:
    """Metres and radians, in the map, which begins where the first day did."""
    D = se3.invert(se3.invert(FIRST_DAY[0]) @ T_room_camera) @ not_none(T)
    return float(np.linalg.norm(D[:3, 3])), float(so3.angle(D[:3, :3]))


@pytest.mark.parametrize("extends", mostly_slow([False, True], quick=[True]))
def test_the_second_day_is_found_in_the_map_of_the_first(before: tuple[Localizer, KnownMap], extends: bool) -> None:
    given = known(before, extends=extends)
    count, T_before = len(given.store), np.array(given.store.T_map_keyframe)
    subject, found = drive(given, frames(SECOND_DAY, 10.0))
    statuses = [answer.status for answer in found]
    joined = statuses.index(Status.TRACKING)
    assert set(statuses[:joined]) == {Status.INITIALIZING}
    assert set(statuses[joined:]) == {Status.TRACKING}
    assert all(answer.T_map_body is None and answer.T_odom_body is not None for answer in found[:joined])
    for answer, truth in zip(found[joined:], SECOND_DAY[joined:], strict=True):
        way_m, turn_rad = off(answer.T_map_body, truth)
        assert way_m < 0.05
        assert turn_rad < np.radians(1.5)
    # In odom it begins where it is, and goes on so.
    np.testing.assert_allclose(not_none(found[0].T_odom_body), np.eye(4), atol=1e-9)
    step = se3.invert(not_none(found[joined - 1].T_odom_body)) @ not_none(found[joined].T_odom_body)
    truth = se3.invert(SECOND_DAY[joined - 1]) @ SECOND_DAY[joined]
    assert np.linalg.norm((se3.invert(truth) @ step)[:3, 3]) < 0.02
    # Once it is over, the whole way is known, from its first frame on.
    closed = not_none(subject.loops).finish()
    subject.close()
    assert closed.is_joined
    assert len(closed.stamps_s) == len(given.store) - count > 0
    assert off(found[0].pose_in(not_none(subject.keyframes)), SECOND_DAY[0])[0] < 0.05
    moved_m = np.linalg.norm(given.store.T_map_keyframe[:count, :3, 3] - T_before[:, :3, 3], axis=1).max()
    assert moved_m < (0.05 if extends else 1e-3)


def test_another_room_is_not_taken_for_the_map(before: tuple[Localizer, KnownMap]) -> None:
    subject, found = drive(known(before), frames(SECOND_DAY, 10.0, seed=3))
    assert {answer.status for answer in found} == {Status.INITIALIZING}
    assert not not_none(subject.loops).finish().is_joined
    subject.close()


def test_who_says_where_it_begins_is_believed_and_corrected(before: tuple[Localizer, KnownMap]) -> None:
    T_true = se3.invert(FIRST_DAY[0]) @ SECOND_DAY[0]
    T_said = se3.exp([0.2, -0.1, 0.1, 0.0, 0.1, 0.0]) @ T_true
    C = np.diag(np.square([0.3] * 3 + [0.2] * 3))
    subject, found = drive(replace(known(before), T_map_camera=T_said, covariance=C), frames(SECOND_DAY, 10.0))
    assert {answer.status for answer in found} == {Status.UNCONFIRMED, Status.TRACKING}
    assert [answer.status for answer in found[-10:]] == [Status.TRACKING] * 10
    np.testing.assert_allclose(not_none(found[0].T_map_body), T_said, atol=1e-6)
    assert off(found[-1].T_map_body, SECOND_DAY[-1])[0] < 0.05
    subject.close()


def test_a_known_map_needs_loops() -> None:
    config = load_config(overrides={"odometry": "dense"})
    empty = KnownMap(KeyframeStore(), Recognizer(), ())
    with pytest.raises(ConfigError, match="needs loop closing"):
        Localizer(CALIBRATION, config, known=empty)
