"""PlaceConfirmation: a place in a known map counts once the camera has confirmed it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wheelsight.core.estimates import PoseFinding
from wheelsight.core.geometry import se3
from wheelsight.estimation.loop_updates import PlaceConfirmation

SPEED_M_S = 0.4


def drive(
    subject: PlaceConfirmation, until_s: float, *, begin_s: float = 0.0, recognised: int = 0, missed: int = 0
) -> list[PoseFinding | None]:
    """Drive straight on with ten poses a second."""
    stamps_s = np.arange(begin_s, until_s, 0.1)
    return [subject.update(s, se3.from_plane(SPEED_M_S * s, 0.0, 0.0), recognised, missed) for s in stamps_s]


def test_a_given_start_is_unconfirmed_until_two_views_recognise_the_map() -> None:
    subject = PlaceConfirmation(is_given=True)
    assert set(drive(subject, 3.0)) == {PoseFinding.UNCONFIRMED}
    assert set(drive(subject, 4.0, begin_s=3.0, recognised=1)) == {PoseFinding.UNCONFIRMED}
    assert set(drive(subject, 60.0, begin_s=4.0, recognised=2)) == {None}
    assert not subject.warnings


def test_a_given_start_that_nothing_confirms_is_refuted_after_some_metres() -> None:
    subject = PlaceConfirmation(is_given=True)
    found = drive(subject, 20.0)
    assert found.index(PoseFinding.NOT_RECOGNISED) * 0.1 * SPEED_M_S == pytest.approx(5.0, abs=0.2)
    assert subject.is_refuted
    assert "near the given start in 5.0 m of way and 13 s" in subject.warnings[0]
    subject.reset(0)
    assert set(drive(subject, 60.0, begin_s=20.0)) == {None}  # the piece of map that begins then is unjoined


@pytest.mark.parametrize(("turn_rad_s", "is_refuted"), [(0.0, False), (0.5, True)])
def test_a_robot_that_turns_has_its_start_refuted_after_some_time_and_one_that_stands_has_not(
    turn_rad_s: float, is_refuted: bool
) -> None:
    subject = PlaceConfirmation(is_given=True)
    jitter_m = np.random.default_rng(0).normal(0, 0.005, (600, 2))
    poses = [se3.from_plane(x, y, 0.1 * n * turn_rad_s) for n, (x, y) in enumerate(jitter_m)]
    found = [subject.update(0.1 * n, T, 0, 0) for n, T in enumerate(poses)]
    assert set(found[:150]) == {PoseFinding.UNCONFIRMED}
    assert (PoseFinding.NOT_RECOGNISED in found[:260]) == is_refuted
    assert subject.is_refuted == is_refuted


def test_a_place_that_was_recognised_is_in_doubt_where_the_map_should_be_seen_and_is_not() -> None:
    subject = PlaceConfirmation(is_given=False)
    assert set(drive(subject, 5.0, recognised=3, missed=4)) == {None}
    assert set(drive(subject, 6.0, begin_s=5.0, recognised=3, missed=5)) == {PoseFinding.UNCONFIRMED}
    assert set(drive(subject, 7.0, begin_s=6.0, recognised=4)) == {None}
    drive(subject, 40.0, begin_s=7.0, recognised=4, missed=9)
    assert subject.is_refuted
    assert "where the robot was taken to be" in subject.warnings[0]
    assert set(drive(subject, 42.0, begin_s=40.0, recognised=5)) == {None}
    assert not subject.is_refuted


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 12)), max_size=60), st.booleans())
def test_no_place_is_confirmed_by_anything_but_recognition(steps: list[tuple[bool, int]], is_given: bool) -> None:
    subject, recognised, needed = PlaceConfirmation(is_given=is_given), 0, 2 if is_given else 0
    for n, (is_recognised, missed) in enumerate(steps):
        recognised += is_recognised
        needed = max(needed - is_recognised, 0)
        missed = 0 if is_recognised else missed
        needed = max(needed, 1) if missed >= 5 else needed
        found = subject.update(0.1 * n, se3.from_plane(0.01 * n, 0.0, 0.0), recognised, missed)
        assert (found is not None) == (needed > 0)
