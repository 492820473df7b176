import numpy as np
import pytest

from wheelsight.core.errors import ArgumentError
from wheelsight.core.geometry import se3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import Match, SpeedVariances
from wheelsight.core.trajectory import Trajectory
from wheelsight.slam.drive_graph import Revisit
from wheelsight.slam.loop_closing import ClosedLoops, Unused, correct, corrected_by, in_map
from wheelsight.slam.loop_gate import LoopReport
from wheelsight.slam.solvers import OwnPoseGraph

SPEED_M_S, SIDE_S, STEP_S = 1.0, 12.0, 0.1
TURN_SIGMA = 0.05  # rad/s of each reading
BIAS_RAD_S = 0.01


def driven(bias_rad_s=BIAS_RAD_S, laps=2):
    """The true way around a square, and the same with a gyroscope's bias; covariances grow by speeds' errors."""
    count = int(4 * laps * SIDE_S / STEP_S)
    stamps_s = np.linspace(0.0, STEP_S * count, count + 1)
    at_corner = np.isclose(np.mod(stamps_s[1:], SIDE_S), 0, atol=1e-6) | np.isclose(
        np.mod(stamps_s[1:], SIDE_S), SIDE_S, atol=1e-6
    )
    steps = np.zeros((count, 6))
    steps[:, 0] = SPEED_M_S * STEP_S
    ways = []
    for bias in (0.0, bias_rad_s):
        T = [np.eye(4)]
        for step, corner in zip(steps, at_corner, strict=True):
            turn = se3.from_plane(0, 0, np.pi / 2 if corner else bias * STEP_S)
            T.append(T[-1] @ se3.exp(step) @ turn)
        ways.append(np.array(T))
    stated = SpeedVariances(stamps_s, np.tile([0.02**2, 0.02**2, TURN_SIGMA**2], (count + 1, 1)))
    return stamps_s, ways[0], ways[1], stated


def matches_of(stamps_s, T_true, wrong=0, relative=False, seed=0):
    """One each two seconds of the second round, and wrong ones."""
    rng = np.random.default_rng(seed)
    half = len(stamps_s) // 2
    found = []
    for late in range(half + 20, len(stamps_s), 20):
        early = late - half
        T = se3.invert(T_true[early]) @ T_true[late] if relative else None
        found.append(Match(float(stamps_s[early]), float(stamps_s[late]), T, score=0.9))
    while wrong:
        a, b = rng.integers(0, len(stamps_s), 2)
        if np.linalg.norm(T_true[a, :3, 3] - T_true[b, :3, 3]) > 4:
            found.append(Match(float(stamps_s[a]), float(stamps_s[b]), score=0.8))
            wrong -= 1
    return found


def rmse_m(trajectory, T_true):
    return float(np.sqrt(np.mean(np.sum((trajectory.positions_m - T_true[:, :3, 3]) ** 2, axis=1))))


def lived_of(stamps_s, T, covariances=None):
    return Trajectory(stamps_s, T, covariances, body="base", frame="odom")


@pytest.mark.parametrize("wrong", [0, 30])
def test_places_recognised_again_bend_the_way_back(wrong):
    stamps_s, T_true, T_lived, stated = driven()
    lived = lived_of(stamps_s, T_lived)
    found = correct(lived, matches_of(stamps_s, T_true, wrong), stated=stated)
    assert (found.corrected.frame, found.corrected.body) == ("map", "base")
    np.testing.assert_array_equal(found.corrected.stamps_s, stamps_s)
    assert rmse_m(found.corrected, T_true) < 0.5 * rmse_m(lived, T_true)
    apart = [
        np.linalg.norm(T_true[found.rows[e.first], :3, 3] - T_true[found.rows[e.second], :3, 3])
        for e in found.loops.kept
    ]
    assert len(apart) >= 20
    assert max(apart) < 4


def test_our_own_solver_comes_to_the_same():
    stamps_s, T_true, T_lived, stated = driven()
    given = (lived_of(stamps_s, T_lived), matches_of(stamps_s, T_true, wrong=10))
    ours, theirs = correct(*given, stated=stated, graph=OwnPoseGraph()), correct(*given, stated=stated)
    np.testing.assert_allclose(ours.corrected.positions_m, theirs.corrected.positions_m, atol=0.02)
    assert [one.is_kept for one in ours.loops.decisions] == [one.is_kept for one in theirs.loops.decisions]


def test_relative_poses_are_better_than_places():
    stamps_s, T_true, T_lived, stated = driven()
    lived = lived_of(stamps_s, T_lived)
    by_place, by_pose = (
        correct(lived, matches_of(stamps_s, T_true, relative=relative), stated=stated) for relative in (False, True)
    )
    start, end = (found.corrected.positions_m[[0, len(stamps_s) // 2]] for found in (by_place, by_pose))
    assert np.linalg.norm(end[1] - end[0]) <= np.linalg.norm(start[1] - start[0]) + 0.05
    assert len(by_pose.loops.refused) == 0


def test_what_is_not_judged_is_counted_by_its_reason():
    stamps_s, _, T_lived, stated = driven()
    matches = [
        Match(1.0, 60.0, score=0.1),
        Match(1.0, 1e4),
        Match(-50.0, 60.0),
        Match(1.0, 1.01),
        Match(1.0, 49.0, score=0.9),
    ]
    found = correct(lived_of(stamps_s, T_lived), matches, stated=stated)
    assert found.unused == {Unused.LOW_SCORE: 1, Unused.NO_POSE: 2, Unused.ONE_PLACE: 1}
    assert len(found.loops.decisions) == 1


def test_without_matches_all_stays_as_it_was():
    stamps_s, _, T_lived, stated = driven()
    found = correct(lived_of(stamps_s, T_lived), [], stated=stated)
    np.testing.assert_allclose(found.corrected.T_frame_body, T_lived, atol=1e-9)


def test_every_pose_keeps_its_place_between_keyframes(monkeypatch):
    stamps_s, T_true, T_lived, stated = driven()
    monkeypatch.setattr("wheelsight.slam.loop_closing._KEYFRAME_WAY_M", 2.0)
    found = correct(lived_of(stamps_s, T_lived), matches_of(stamps_s, T_true), stated=stated)
    np.testing.assert_allclose(found.corrected.T_frame_body[found.rows], found.T_map_keyframe, atol=1e-9)
    steps_m = np.linalg.norm(np.diff(found.corrected.positions_m, axis=0), axis=1)
    assert np.abs(steps_m - SPEED_M_S * STEP_S).max() < 0.01


def test_a_pose_before_another_piece_goes_with_its_own_keyframe_alone():
    stamps_s = np.arange(5.0)
    lived = Trajectory(stamps_s, np.tile(np.eye(4), (5, 1, 1)))
    T_map_odom = np.stack([se3.from_plane(x_m, 0.0, 0.0) for x_m in (0.0, 10.0)])
    blended, apart = (
        in_map(lived, np.array([0.0, 4.0]), T_map_odom, begins) for begins in (None, np.array([False, True]))
    )
    np.testing.assert_allclose(blended.positions_m[:, 0], [0.0, 2.5, 5.0, 7.5, 10.0])
    np.testing.assert_allclose(apart.positions_m[:, 0], [0.0, 0.0, 0.0, 0.0, 10.0])


def test_covariances_of_speeds_add_up_as_a_random_walk():
    stamps_s, _, T_lived, stated = driven(bias_rad_s=0.0)
    half = int(SIDE_S / STEP_S) - 2
    lived = lived_of(stamps_s[:half], T_lived[:half])
    found = correct(
        lived, [Match(0.0, float(stamps_s[half - 1]), np.linalg.inv(T_lived[0]) @ T_lived[half - 1])], stated=stated
    )
    (judged,) = found.loops.decisions
    assert judged.chi2 < 1e-6
    assert judged.is_kept


def test_a_trajectory_that_states_no_errors_cannot_be_weighed():
    stamps_s, _, T_lived, _ = driven()
    with pytest.raises(ArgumentError, match="no covariances"):
        correct(lived_of(stamps_s, T_lived), [Match(0.0, 1.0)])
    with pytest.raises(ArgumentError, match="no poses"):
        correct(lived_of(stamps_s[:0], T_lived[:0]), [])


def test_a_pose_goes_with_a_keyframe_that_was_seen_again():
    """Nothing new is kept for ten seconds of known rooms, while odom drifts by 0.4 m and is back by wheels alone."""
    T_kept = np.array([se3.from_plane(x_m, 0.0, 0.0) for x_m in (0.0, 10.0)])
    again = Revisit(KeyframeId(0), 5.0, se3.from_plane(0.0, 0.4, 0.0), np.eye(6), np.eye(6))
    reported = (np.ones(2, bool), np.zeros(2, bool), np.zeros(2))
    closed = ClosedLoops(np.array([0.0, 10.0]), T_kept, T_kept, (), LoopReport(()), {}, 0, 1, *reported, (again,))
    stamps_s = np.arange(0.0, 11.0)
    lived = Trajectory(stamps_s, np.array([se3.from_plane(x_m, 0.4, 0.0) for x_m in stamps_s]))
    found = corrected_by(closed, lived)
    np.testing.assert_allclose(found.corrected.T_frame_body[5], se3.from_plane(5.0, 0.0, 0.0), atol=1e-9)
    shares = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0]
    np.testing.assert_allclose(found.corrected.positions_m[:, 1], 0.4 * (1 - np.array(shares)), atol=1e-9)
    np.testing.assert_array_equal(found.rows, [0, 10])
