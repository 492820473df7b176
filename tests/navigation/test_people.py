"""PeopleTracker: who walks is followed from a robot that drives and turns; what stands never walks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from navigation.unicycle import Camera
from scipy.stats import chi2

from wheelsight.core.geometry import FloatArray
from wheelsight.navigation import PeopleTracker, Person
from wheelsight.navigation.perception import CHANGE_M2_S3, SIGMA_M, WALK_M_S, DepthView, PersonTrack, discs_of

FRAME_S = 0.1
BODY_M = 0.25
ROUND = np.column_stack([np.cos(np.arange(48) * np.pi / 24), np.sin(np.arange(48) * np.pi / 24)])
CAMERA = Camera()
# Speeds of the robot: forward and turn.
MOVES = {"stands": (0.0, 0.0), "drives": (0.6, 0.0), "turns": (0.0, 0.2), "curves": (0.5, -0.15)}
# Begin and velocity in `odom`.
WALKS = {
    "across": ((3.0, -1.2), (0.0, 1.0)),
    "toward": ((3.6, 0.1), (-0.8, 0.0)),
    "away": ((1.6, 0.2), (1.1, 0.0)),
    "aslant": ((3.4, 1.0), (-0.7, -0.8)),
}


def pose_of(move: tuple[float, float], time_s: float) -> FloatArray:
    """On an arc from the origin."""
    v, w = move
    if w == 0:
        return np.array([v * time_s, 0.0, 0.0])
    return np.array([v / w * np.sin(w * time_s), v / w * (1 - np.cos(w * time_s)), w * time_s])


def line(a: Sequence[float], b: Sequence[float]) -> FloatArray:
    way = np.subtract(b, a)
    return np.asarray(a + np.linspace(0, 1, 2 + int(np.hypot(*way) / 0.05))[:, None] * way)


def box(x: float, y: float, width_m: float, depth_m: float, yaw: float) -> FloatArray:
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (width_m / 2, depth_m / 2)
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    corners = corners @ R.T + (x, y)
    return np.concatenate([line(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])


def anywhere(view: DepthView) -> np.ndarray:
    return np.ones(len(view.points), bool)


@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("walk", WALKS)
def test_who_walks_is_followed_by_a_robot_that_drives(walk: str, move: str) -> None:
    rng, subject = np.random.default_rng(5), PeopleTracker(far_m=CAMERA.far_m)
    begin, velocity = (np.array(part) for part in WALKS[walk])
    wall = line((4.6, -3.0), (4.6, 3.0))
    reported: list[tuple[Person, FloatArray]] = []
    for n in range(25):
        now_s, pose = n * FRAME_S, pose_of(MOVES[move], n * FRAME_S)
        middle = begin + now_s * velocity
        points = np.concatenate([BODY_M * ROUND + middle, wall]) + rng.normal(0, 0.01, (len(ROUND) + len(wall), 2))
        view = CAMERA.view(points, pose, now_s)
        subject.update(view, pose, anywhere(view))
        reported += [(person, middle) for person in subject.people(now_s)]
    assert len(reported) >= 5
    offs = np.array([person.velocity - velocity for person, _ in reported])
    places = np.array([person.position - middle for person, middle in reported])
    assert np.hypot(*np.median(offs, axis=0)) < 0.15
    assert np.hypot(*offs.T).max() < 0.5
    # Once he is out of sight, as much more as the filter says.
    sigmas = [np.sqrt(np.linalg.eigvalsh(person.covariance[:2, :2])[-1]) for person, _ in reported]
    assert (np.hypot(*places.T) < 0.1 + np.array(sigmas)).all()
    assert min(person.radius_m for person, _ in reported) >= BODY_M


@pytest.mark.parametrize("move", MOVES)
def test_a_wall_never_walks(move: str) -> None:
    rng, subject = np.random.default_rng(6), PeopleTracker(far_m=CAMERA.far_m)
    walls = [line((2.5, -0.5), (3.4, 0.4)), line((3.0, 0.8), (3.0, 2.5)), box(2.2, -1.0, 0.4, 0.4, 0.3)]
    world = np.concatenate(walls)
    for n in range(60):
        pose = pose_of(MOVES[move], n * FRAME_S)
        view = CAMERA.view(world + rng.normal(0, 0.01, world.shape), pose, n * FRAME_S)
        # The pose is off by what odometry is off from frame to frame.
        subject.update(view, pose + rng.normal(0, (0.01, 0.01, 0.005)), anywhere(view))
        assert subject.people(n * FRAME_S) == ()


@hypothesis_settings(max_examples=40, deadline=None)
@given(
    st.tuples(st.floats(1.0, 3.5), st.floats(-1.5, 1.5)),
    st.tuples(st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.floats(0, 3.1)),
    st.tuples(st.floats(-0.2, 1.0), st.floats(-1.0, 1.0)),
    st.integers(0, 1000),
)
def test_whatever_stands_is_no_one_who_walks(
    at: tuple[float, float], shape: tuple[float, float, float], move: tuple[float, float], seed: int
) -> None:
    """One box behind another, which cuts it off from view in part, from any robot that moves."""
    rng, subject = np.random.default_rng(seed), PeopleTracker(far_m=CAMERA.far_m)
    world = np.concatenate([box(*at, *shape), box(at[0] + 0.8, at[1] + 0.3, 0.7, 0.5, 0.2)])
    for n in range(25):
        pose = pose_of(move, n * FRAME_S)
        if np.hypot(*(world - pose[:2]).T).min() < 0.8:
            return  # it would drive into them
        view = CAMERA.view(world + rng.normal(0, 0.01, world.shape), pose, n * FRAME_S)
        subject.update(view, pose, anywhere(view))
        assert subject.people(n * FRAME_S) == ()


def test_covariances_are_as_large_as_errors() -> None:
    """Normalized estimation error squared, of walks as the filter takes them for: mean of χ² of four degrees."""
    rng, runs, frames = np.random.default_rng(7), 150, 20
    R = SIGMA_M**2 * np.eye(2)
    step = np.kron(np.array([[FRAME_S**3 / 3, FRAME_S**2 / 2], [FRAME_S**2 / 2, FRAME_S]]), np.eye(2))
    nees = np.zeros(frames)
    for _ in range(runs):
        truth = np.array([2.0, 1.0, *rng.normal(0, WALK_M_S, 2)])
        track = PersonTrack(0.0, truth[:2] + rng.normal(0, SIGMA_M, 2), R)
        for n in range(frames):
            truth[:2] += FRAME_S * truth[2:]
            truth += rng.multivariate_normal(np.zeros(4), CHANGE_M2_S3 * step)
            track.predict((n + 1) * FRAME_S)
            track.correct(truth[:2] + rng.normal(0, SIGMA_M, 2), R)
            off = truth - track.state
            nees[n] += off @ np.linalg.solve(track.covariance, off) / runs
    low, high = chi2.ppf((0.0005, 0.9995), 4 * runs) / runs
    assert ((nees > low) & (nees < high)).all()


def walker(now_s: float, seen: bool = True) -> DepthView:
    middle = np.array([3.0, -0.8 + now_s])
    return CAMERA.view(BODY_M * ROUND + middle if seen else np.empty((0, 2)), np.zeros(3), now_s)


def test_who_is_out_of_sight_is_forgotten_after_a_second() -> None:
    subject = PeopleTracker(far_m=CAMERA.far_m)
    for n in range(10):
        subject.update(walker(n * FRAME_S), np.zeros(3), anywhere(walker(n * FRAME_S)))
    known = {}
    for n in range(10, 25):
        subject.update(walker(n * FRAME_S, seen=False), np.zeros(3), np.empty(0, bool))
        known[n] = subject.people(n * FRAME_S)
    assert len(known[15]) == 1
    assert known[15][0].position[1] == pytest.approx(0.7, abs=0.2)
    assert np.trace(known[15][0].covariance) > np.trace(known[10][0].covariance)
    assert known[22] == ()


def test_what_the_map_has_is_no_one() -> None:
    subject = PeopleTracker(far_m=CAMERA.far_m)
    for n in range(15):
        subject.update(walker(n * FRAME_S), np.zeros(3), ~anywhere(walker(n * FRAME_S)))
        assert subject.people(n * FRAME_S) == ()


def test_who_stops_is_no_one_who_walks() -> None:
    subject = PeopleTracker(far_m=CAMERA.far_m)
    for n in range(30):
        now_s = n * FRAME_S
        seen = walker(min(now_s, 1.0))
        view = DepthView(now_s, seen.points, seen.camera, seen.first_rad, seen.step_rad, seen.seen_m, seen.near_m)
        subject.update(view, np.zeros(3), anywhere(view))
        if n == 10:
            assert len(subject.people(now_s)) == 1
    assert subject.people(now_s) == ()


def test_in_another_frame_all_of_it_is_turned() -> None:
    person = Person(np.array([1.0, 2.0]), np.array([0.5, 0.0]), np.diag([1.0, 2.0, 3.0, 4.0]), 0.3)
    other = person.carried(np.array([1.0, -1.0, np.pi / 2]))
    np.testing.assert_allclose(discs_of([other]), [[-1.0, 0.0, 0.0, 0.5, 0.3]], atol=1e-12)
    np.testing.assert_allclose(np.diag(other.covariance), [2.0, 1.0, 4.0, 3.0], atol=1e-12)
    assert discs_of([]).shape == (0, 5)
