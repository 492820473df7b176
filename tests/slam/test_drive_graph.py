"""How surely the newest keyframe of a drive is placed, against closed forms."""

import numpy as np
from narrowing import not_none

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.places.recognition import Recognizer
from wheelsight.slam.drive_graph import DriveGraph, OdometryKeyframe, Revisit
from wheelsight.slam.graph import ANCHOR_SIGMA, RelativePose
from wheelsight.slam.place_recognition import KnownMap

STEP = np.diag(np.square([0.02] * 3 + [0.01] * 3))
SEEN = np.diag(np.square([0.03] * 3 + [0.02] * 3))


def lived(number: int, passed: int, *, begins: bool = False) -> OdometryKeyframe:
    """One a metre farther on, by a pose that each step makes less certain."""
    C = STEP * passed + 1e-10 * np.eye(6)
    return OdometryKeyframe(KeyframeId(number), float(number), se3.exp([passed, 0, 0, 0, 0, 0]), C, begins)


def known_map(count: int) -> KnownMap:
    store, blank = KeyframeStore(), np.ones((24, 32), np.float32)
    for number in range(count):
        keyframe = Keyframe.of_images(float(number), np.array([30.0, 30.0, 16.0, 12.0]), blank, blank)
        store.add(keyframe, se3.exp([0.0, number, 0, 0, 0, 0]))
    return KnownMap(store, Recognizer())


def loop(first: int, second: int, T: FloatArray) -> RelativePose:
    return RelativePose(KeyframeId(first), KeyframeId(second), T, SEEN, is_loop=True)


def test_a_chain_grows_as_its_steps_do() -> None:
    graph = DriveGraph()
    assert graph.place() is None
    for number in range(4):
        graph.add(lived(number, number))
        graph.close([])
    place = graph.place()
    assert place is not None
    assert place.number == 3
    np.testing.assert_allclose(place.T_map_keyframe, se3.exp([3.0, 0, 0, 0, 0, 0]), atol=1e-6)
    # Odometry's covariance at the keyframe, the least error of each step, and what holds the first one.
    least = np.diag(np.full(6, 1e-6))
    expected = 3 * STEP + ANCHOR_SIGMA**2 * np.eye(6)
    for way_m in range(3):
        Ad = se3.adjoint(se3.exp([float(way_m), 0, 0, 0, 0, 0]))
        expected = expected + Ad @ least @ Ad.T
    np.testing.assert_allclose(place.covariance, expected, rtol=0.01, atol=1e-6)


def test_a_keyframe_seen_again_is_as_sure_as_it_is_and_the_view_of_it() -> None:
    graph = DriveGraph()
    for number in range(4):
        graph.add(lived(number, number))
        graph.close([])
        if number == 1:
            then = not_none(graph.place())
    T_odom, C_odom = se3.exp([1.1, 0, 0, 0, 0, 0.02]), 9 * STEP
    place = not_none(graph.place(Revisit(KeyframeId(1), 9.0, T_odom, C_odom, SEEN)))
    assert (place.number, place.newest) == (1, 3)
    np.testing.assert_array_equal(place.T_odom_keyframe, T_odom)
    np.testing.assert_array_equal(place.covariance_odom, C_odom)
    Ad = se3.adjoint(then.T_map_keyframe)
    np.testing.assert_allclose(place.covariance, then.covariance + Ad @ SEEN @ Ad.T, rtol=0.01, atol=1e-6)


def test_a_piece_is_placed_once_loops_join_it_and_more_surely_by_more_of_them() -> None:
    graph = DriveGraph(known_map(3))
    sigmas_m = []
    for passed in range(3):
        graph.add(lived(3 + passed, passed, begins=not passed))
        # The drive goes along y of the map; each keyframe sees the one of the map that it lies at.
        graph.close([loop(passed, 3 + passed, se3.exp([0.0, 0.0, 0.0, 0.0, 0.0, np.pi / 2]))])
        place = graph.place()
        assert graph.unjoined == (() if place else (3,))
        C = None if place is None else se3.position_covariance(place.T_map_keyframe, place.covariance)
        sigmas_m.append(None if C is None else float(np.sqrt(np.linalg.eigvalsh(C)[-1])))
    lone, two, three = sigmas_m
    assert lone is None
    assert not_none(three) < not_none(two) < 0.03
    np.testing.assert_allclose(graph.poses[-1][:3, 3], [0.0, 2.0, 0.0], atol=1e-3)
