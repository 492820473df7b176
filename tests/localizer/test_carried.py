"""KidnapDetection: the estimate of a robot that may have been carried in the dark."""

from __future__ import annotations

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.estimates import PoseFinding
from wheelsight.core.geometry import se3
from wheelsight.estimation.consistency_check import KidnapDetection

HERE = np.eye(4), 1e-6 * np.eye(6)
SPREAD = np.eye(4), np.eye(6)
AHEAD = se3.exp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])


def kidnapped() -> KidnapDetection:
    """In a dark of 4 s, at the origin."""
    subject = KidnapDetection()
    subject.add_known_view(0.0)
    subject.add_unknown_view(4.0, AHEAD, np.eye(4))
    return subject


def test_wheels_that_stood_and_another_view_say_so_and_a_known_view_takes_it_back() -> None:
    subject = kidnapped()
    assert subject.is_kidnapped
    evidence = not_none(subject.update_evidence(*HERE))
    assert evidence.finding is PoseFinding.KIDNAPPED
    sigmas = np.sqrt(np.diag(not_none(evidence.covariance)))
    np.testing.assert_allclose(sigmas[[0, 1, 5]], [2.8, 2.8, np.pi / np.sqrt(3)], rtol=1e-3)
    subject.add_known_view(10.0)
    assert not subject.is_kidnapped


@pytest.mark.parametrize(("way_m", "is_kidnapped"), [(0.4, True), (0.8, False)])
def test_wheels_that_went_on_farther_than_a_view_is_recognised_tell_why_it_changed(
    way_m: float, is_kidnapped: bool
) -> None:
    subject = KidnapDetection()
    subject.add_known_view(0.0)
    gone = se3.exp([0.0, 0.0, way_m, 0.0, 0.0, 0.0])
    subject.add_unknown_view(4.0, gone, np.eye(4))
    assert subject.is_kidnapped == is_kidnapped
    assert not subject.waits(gone)


def test_frames_that_are_not_believed_show_what_is_known_all_the_same() -> None:
    """A camera that contradicts the wheels for seconds is not in the dark."""
    subject = KidnapDetection()
    for stamp_s in np.arange(0.0, 4.0, 0.1):
        subject.add_known_view(stamp_s)
    subject.add_unknown_view(4.0, AHEAD, np.eye(4))
    assert not subject.is_kidnapped


def test_from_then_on_a_way_leads_astray() -> None:
    subject = kidnapped()
    subject.inflate(np.eye(4), np.eye(6))
    gone = not_none(subject.update_evidence(se3.from_plane(3.0, 0.0, 0.0), np.eye(6)))
    assert np.sqrt(not_none(gone.covariance)[0, 0] - 1.0) == pytest.approx(2.0)


@pytest.mark.parametrize(("sigma_rad", "is_kidnapped"), [(0.4, False), (0.6, True)])
def test_a_heading_that_is_known_again_ends_it(sigma_rad: float, is_kidnapped: bool) -> None:
    subject = kidnapped()
    subject.inflate(np.eye(4), np.eye(6))
    subject.update_evidence(np.eye(4), sigma_rad**2 * np.eye(6))
    assert subject.is_kidnapped == is_kidnapped


def stood(seconds: float, way_m: float = 0.0) -> KidnapDetection:
    """Wheels that stood, but for such a way halfway, until the last known view at 10 s."""
    subject = KidnapDetection()
    subject.add_wheels(10.0 - seconds, np.eye(4))
    subject.add_wheels(10.0 - seconds / 2, se3.from_plane(way_m, 0.0, 0.0))
    subject.add_known_view(10.0)
    return subject


@pytest.mark.parametrize(
    ("seconds", "way_m", "is_kidnapped"), [(3.0, 0.01, True), (3.0, 0.05, False), (1.5, 0.0, False)]
)
def test_another_view_at_once_is_an_elevators_where_the_wheels_stood_before(
    seconds: float, way_m: float, is_kidnapped: bool
) -> None:
    subject = stood(seconds, way_m)
    subject.add_unknown_view(10.03, AHEAD, np.eye(4))
    assert subject.is_kidnapped == is_kidnapped


def test_another_view_without_dark_or_a_long_stand_says_nothing_though_the_wheels_have_not_moved_at_all() -> None:
    subject = stood(1.5)
    subject.add_unknown_view(10.03, np.eye(4), np.eye(4))
    assert not subject.is_kidnapped


def test_an_elevator_may_have_gone_to_another_floor_and_the_dark_has_not() -> None:
    subject = stood(3.0)
    subject.add_unknown_view(10.03, AHEAD, np.eye(4))
    of_elevator, of_dark = (not_none(not_none(one.update_evidence(*HERE)).covariance) for one in (subject, kidnapped()))
    np.testing.assert_allclose(np.sqrt(np.diag(of_elevator))[:3], [0.7 * 3.03, 0.7 * 3.03, 3.0], rtol=1e-3)
    assert np.sqrt(of_dark[2, 2]) < 0.01


def test_who_hides_the_view_of_a_robot_that_stands_on_may_go_away() -> None:
    subject = stood(3.0)
    subject.add_unknown_view(10.03, AHEAD, np.eye(4))
    assert subject.waits(AHEAD)
    assert not subject.waits(se3.exp([0.0, 0.0, 0.4, 0.0, 0.0, 0.0]))
    assert not subject.waits(None)
    subject.add_known_view(11.0)
    assert not subject.waits(AHEAD)
    assert subject.update_evidence(*HERE) is None


def test_a_camera_that_began_again_waits_for_nothing() -> None:
    subject = stood(3.0)
    subject.add_unknown_view(10.03, AHEAD, np.eye(4))
    subject.inflate(np.eye(4), np.eye(6))
    assert not subject.waits(AHEAD)


def test_loops_that_join_where_it_was_put_end_it_and_no_others_do() -> None:
    subject = kidnapped()
    subject.inflate(np.eye(4), np.eye(6))
    subject.relocalized()  # loops have always been joined; no piece has begun here
    assert subject.update_evidence(*SPREAD) is not None
    subject.begin_submap()
    assert subject.update_evidence(*SPREAD) is not None
    subject.relocalized()
    assert subject.update_evidence(*SPREAD) is None
