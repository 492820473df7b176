"""ByWheels: wheels with a gyroscope are hardly ever worse than wheels alone, whatever is wrong with the gyroscope."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from grids import mostly_slow
from narrowing import not_none

from wheelsight.config import load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.estimates import Estimate, Status
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import Event, WheelTicks, YawRate
from wheelsight.estimation import Localizer
from wheelsight_sim import Drive, RobotModel, SimulationSettings, simulate

CALIBRATION = Calibration(wheels=Wheels(0.17, 0.17, 0.52, 3200.0), source="tape measure")
Change = Callable[[YawRate], YawRate | None]


@cache
def driven(seed: int, **robot: float) -> Drive:
    """25 s through a flat, without a rest; the gyroscope's bias is one of many."""
    true = RobotModel(has_gyro=True, **robot)  # type: ignore[arg-type]
    return simulate(SimulationSettings(world="flat", duration_s=25.0, seed=seed, robot=true)).drive


def events_of(drive: Drive, change: Change = lambda rate: rate, rest_s: float = 0.0) -> list[Event]:
    """Readings in order of time, the gyroscope's as they are changed; after a rest, if any."""
    noise = np.random.default_rng(1).normal(0, 0.01, round(rest_s / 0.01))
    at_rest = [YawRate(-0.01 * (i + 1), float(bias_of(drive) + off)) for i, off in enumerate(noise)]
    rates = [given for rate in (*at_rest, *drive.yaw_rates) if (given := change(rate)) is not None]
    first = drive.ticks[0]
    standing = [WheelTicks(-0.02 * (i + 1), first.left, first.right) for i in range(round(rest_s / 0.02))]
    return sorted([*rates, *standing, *drive.ticks], key=lambda event: event.stamp_s)


def bias_of(drive: Drive) -> float:
    """What the gyroscope shows on average beyond what the base turned."""
    R = drive.truth.T_frame_body[:, :2, :2]
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    shown = np.mean([rate.yaw_rate_rad_s for rate in drive.yaw_rates])
    return float(shown - (yaw[-1] - yaw[0]) / drive.truth.duration_s)


def answers_to(events: Sequence[Event], **settings: Any) -> tuple[Localizer, list[Estimate], list[str]]:
    subject, answers, notes = Localizer(CALIBRATION, load_config(overrides={"odometry": "wheels"} | settings)), [], []
    for event in events:
        answer = subject.process(event)
        answers += [] if answer is None else [answer]
        notes += [subject.note] if subject.note else []
    return subject, answers, notes


def rmse_m(answers: Sequence[Estimate], drive: Drive) -> float:
    """Of the positions, from the true start."""
    reported = [answer for answer in answers if answer.stamp_s >= 0]
    T_true = drive.truth.at([answer.stamp_s for answer in reported])
    T = np.array([answer.T_filter_body for answer in reported])
    start = se3.invert(T_true[0]) @ T_true
    return float(np.sqrt(np.mean(np.sum((T[:, :2, 3] - start[:, :2, 3]) ** 2, axis=1))))


@cache
def by_wheels_alone(seed: int, rest_s: float) -> list[Estimate]:
    return answers_to(events_of(driven(seed), rest_s=rest_s), **{"wheels.gyro": False})[1]


@pytest.mark.parametrize(
    ("seed", "rest_s"),
    mostly_slow([(seed, 10.0 * (seed % 2)) for seed in range(1, 5)], quick=[(1, 10.0), (2, 0.0)]),
)
def test_wheels_with_a_gyroscope_are_hardly_worse_than_wheels_alone(seed: int, rest_s: float) -> None:
    subject, both, notes = answers_to(events_of(driven(seed), rest_s=rest_s))
    alone = by_wheels_alone(seed, rest_s)
    assert rmse_m(both, driven(seed)) < 1.2 * rmse_m(alone, driven(seed)) + 0.005
    assert both[-1].covariance[5, 5] < 0.05 * alone[-1].covariance[5, 5]  # type: ignore[index]
    assert subject.warnings == ()
    assert not notes


@pytest.mark.parametrize("seed", mostly_slow([1, 2, 3], quick=[1]))
def test_what_wheels_have_wrong_the_gyroscope_shows(seed: int) -> None:
    """Radii a percent apart and a track 2 % wrong, of a robot that never rests."""
    drive = driven(seed, right_radius_m=0.1717, track_width_m=0.53)
    both, alone = (answers_to(events_of(drive), **{"wheels.gyro": gyro})[1] for gyro in (True, False))
    assert rmse_m(alone, drive) > 0.3
    assert rmse_m(both, drive) < 0.15


FAULTS: dict[str, tuple[Change, str]] = {
    "sign": (lambda rate: YawRate(rate.stamp_s, -rate.yaw_rate_rad_s), "turns the other way"),
    "degrees": (lambda rate: YawRate(rate.stamp_s, float(np.degrees(rate.yaw_rate_rad_s))), "degrees instead of"),
    "twice": (lambda rate: YawRate(rate.stamp_s, 2 * rate.yaw_rate_rad_s), "times as fast"),
    "half": (lambda rate: YawRate(rate.stamp_s, rate.yaw_rate_rad_s / 2), "times as fast"),
    "zeros": (lambda rate: YawRate(rate.stamp_s, 0.0), "stays at 0 rad/s"),
    "stuck": (lambda rate: YawRate(rate.stamp_s, -0.0321), "stays at -0.0321 rad/s"),
    "late": (lambda rate: YawRate(rate.stamp_s + 0.2, rate.yaw_rate_rad_s), "0.2 s late"),
    "another clock": (lambda rate: YawRate(rate.stamp_s + 1.6e9, rate.yaw_rate_rad_s), "ahead of that of the wheels"),
    "an earlier clock": (lambda rate: YawRate(rate.stamp_s - 1000, rate.yaw_rate_rad_s), "behind that of the wheels"),
}


def test_what_the_gyroscope_shows_the_way_so_far_is_no_motion_in_odom() -> None:
    drive = driven(1, right_radius_m=0.1717, track_width_m=0.53)
    both, alone = (answers_to(events_of(drive), **{"wheels.gyro": gyro})[1] for gyro in (True, False))

    def steps_m(T: Sequence[FloatArray | None]) -> FloatArray:
        return np.asarray(np.linalg.norm(np.diff(np.array(T)[:, :2, 3], axis=0), axis=1))

    rolled_m = steps_m([answer.T_odom_body for answer in alone])
    leaps_m = np.abs(steps_m([answer.T_filter_body for answer in both]) - rolled_m)
    assert leaps_m.max() > 0.01
    assert np.abs(steps_m([answer.T_odom_body for answer in both]) - rolled_m).max() < 1e-4
    for answer in both:
        np.testing.assert_allclose(not_none(answer.T_map_body), not_none(answer.T_filter_body), atol=1e-12)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("rest_s", [0.0, 5.0])
def test_a_gyroscope_that_contradicts_the_wheels_is_named_and_moves_nothing(fault: str, rest_s: float) -> None:
    """Within 10 s; of what comes until then and for 5 s after it, nothing is left in any answer."""
    change, said = FAULTS[fault]
    events = [event for event in events_of(driven(4), change, rest_s) if not 15 < event.stamp_s < 100]
    subject, both, notes = answers_to(events)
    alone = [answer for answer in by_wheels_alone(4, rest_s) if answer.stamp_s <= 15]
    assert all("gyroscope" in warning and "left out" in warning for warning in subject.warnings)
    assert any(said in warning for warning in subject.warnings)
    assert len(notes) == (0 if "clock" in fault else 1)
    is_open = fault in ("twice", "half")  # the wheels may as well be wrong
    for ours, theirs in zip(both, alone, strict=True):
        np.testing.assert_array_equal(ours.T_odom_body, theirs.T_odom_body)
        more = not_none(ours.covariance) - not_none(theirs.covariance)
        assert np.linalg.eigvalsh(more)[0] > -1e-12 if is_open else not more.any()
    assert both[-1].status is (Status.COASTING if is_open else Status.TRACKING)
    if is_open:  # one standard deviation covers the difference of both turns
        turned = [not_none(each[-1].covariance)[5, 5] for each in (both, alone)]
        angle = np.unwrap([np.arctan2(T[1, 0], T[0, 0]) for T in (not_none(one.T_odom_body) for one in alone)])
        factor = 2.0 if fault == "twice" else 0.5
        apart_rad = abs((angle[-1] - angle[0]) * (1 - factor))
        assert np.sqrt(turned[0] - turned[1]) > 0.5 * apart_rad  # the gyroscope also has a bias


@pytest.mark.parametrize("rate_rad_s", [0.0, 0.4, -3.0])
def test_where_it_fails_on_the_way_the_wheels_go_on_from_where_both_agreed(rate_rad_s: float) -> None:
    """Unplugged after 12 s of 25: what it reported until then stays, what came since counts as never reported."""
    broken = events_of(driven(4), lambda rate: rate if rate.stamp_s < 12 else YawRate(rate.stamp_s, rate_rad_s))
    ended = events_of(driven(4), lambda rate: rate if rate.stamp_s < 12 else None)
    subject, both, (note,) = answers_to(broken)
    assert "left out" in note
    assert subject.warnings
    T, expected = both[-1].T_filter_body, answers_to(ended)[1][-1].T_filter_body
    assert T is not None
    assert expected is not None
    off = se3.invert(expected) @ T
    assert np.hypot(*off[:2, 3]) < 0.03
    assert abs(np.arctan2(off[1, 0], off[0, 0])) < 0.005
