"""ByFusion with a gyroscope: believed once it has agreed with the wheels, with what the calibration says of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from grids import mostly_slow
from localizer.joined_drives import CALIBRATION, WHEELS, Drive, Sight, answers_to, drive, joined, yaw_rates
from narrowing import not_none

from wheelsight.config import load_config
from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.estimates import Reason
from wheelsight.core.geometry import se3, so3
from wheelsight.core.messages import Event, WheelTicks, YawRate
from wheelsight.estimation import ErrorStateFilter, FusedEstimate
from wheelsight.estimation.fusion_localizer import ByFusion
from wheelsight.wheels import WheelOdometry

JOINED = {"odometry": "wheels,dense"}
SHORT = ((2.0, 0.6, 0.2),)


def dark_after(begin_s: float, seconds: float) -> Sight:
    """What a drive shows at so many seconds: nothing after some."""
    return Sight(Reason.TOO_LITTLE_DEPTH) if seconds > begin_s else Sight()


def test_the_gyroscope_is_taken_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the filter alone, to the last bit, and not by the wheels before it as well."""
    made = drive(SHORT)
    monkeypatch.setattr("wheelsight.estimation.wheel_localizer.ByWheels.trusts_gyro", True)
    readings = [event for event in made.events() if isinstance(event, WheelTicks)]
    reported: list[Event] = [*readings, *yaw_rates(made, 0.01)]
    events = sorted(reported, key=lambda event: event.stamp_s)
    answers = answers_to(joined(monkeypatch, made.eye())[0], events)
    assert len(answers) == len(readings)
    wheels, by_hand = WheelOdometry(WHEELS), ErrorStateFilter(CALIBRATION.T_base_camera)
    for event in events:
        if isinstance(event, WheelTicks):
            expected = by_hand.predict_to(wheels.process(event))
        elif isinstance(event, YawRate):
            by_hand.update_yaw_rate(event.stamp_s, event.yaw_rate_rad_s)
    np.testing.assert_allclose(not_none(answers[-1][1].T_filter_body), not_none(expected.T_odom_body), atol=1e-12)
    np.testing.assert_allclose(not_none(answers[-1][1].filter_covariance), not_none(expected.covariance), atol=1e-12)


def test_a_gyroscope_that_is_not_wanted_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = drive(SHORT)
    monkeypatch.setattr("wheelsight.estimation.wheel_localizer.ByWheels.trusts_gyro", True)
    both = sorted([*made.events(), *yaw_rates(made, 0.5)], key=lambda event: event.stamp_s)
    without = answers_to(joined(monkeypatch, made.eye())[0], made.events())
    off: dict[str, Any] = {"wheels.gyro": False}
    unwanted = answers_to(joined(monkeypatch, made.eye(), **off)[0], both)
    wanted = answers_to(joined(monkeypatch, made.eye())[0], both)
    np.testing.assert_array_equal(without[-1][1].covariance, unwanted[-1][1].covariance)
    assert not np.array_equal(not_none(without[-1][1].covariance), not_none(wanted[-1][1].covariance))


def test_a_gyroscope_carries_the_turn_through_a_blackout(monkeypatch: pytest.MonkeyPatch) -> None:
    """From when on it has agreed with the wheels."""
    made = drive(((5.0, 0.5, 0.4), (4.0, 0.6, -0.3)), partial(dark_after, 6.5))
    both = sorted([*made.events(), *yaw_rates(made, 0.02)], key=lambda event: event.stamp_s)
    yaw_sigma = [
        np.sqrt(not_none(answers_to(joined(monkeypatch, made.eye())[0], events)[-1][1].covariance)[5, 5])
        for events in (made.events(), both)
    ]
    assert yaw_sigma[1] < 0.5 * yaw_sigma[0]


def test_the_filter_knows_what_the_calibration_says_of_the_gyroscope() -> None:
    gyro = Gyro(0.002, bias_rad_s=-0.1, bias_sigma_rad_s=0.003, bias_walk_rad_s_per_sqrt_s=1e-4)
    assert ByFusion(replace(CALIBRATION, gyro=gyro), load_config(overrides=JOINED)).filter.parameters.gyro == gyro


@pytest.mark.parametrize("is_stated", mostly_slow([True, False], quick=[False]))
def test_straight_on_a_bias_does_not_turn_the_base(monkeypatch: pytest.MonkeyPatch, is_stated: bool) -> None:
    """Six seconds in the dark, after a turn by which the gyroscope has shown that it is one."""
    made = drive(((6.0, 0.5, 0.5), (5.5, 0.6, 0.0)), partial(dark_after, 6.5))
    gyro = Gyro(bias_rad_s=0.1, bias_sigma_rad_s=1e-3) if is_stated else Gyro(bias_sigma_rad_s=0.1)
    calibration = replace(CALIBRATION, gyro=gyro)
    events = sorted([*made.events(), *yaw_rates(made, 0.1)], key=lambda event: event.stamp_s)
    answers, without = (
        [answer for _, answer in answers_to(joined(monkeypatch, made.eye(), calibration=calibration)[0], given)]
        for given in (events, made.events())
    )
    assert not np.array_equal(not_none(answers[-1].covariance), not_none(without[-1].covariance)), "it was left out"
    begin = next(answer for answer in answers if answer.stamp_s > made.begin_s + 6.6)
    assert begin.T_odom_body is not None
    turned = se3.invert(begin.T_odom_body) @ not_none(answers[-1].T_odom_body)
    truth = se3.invert(made.truth.at([begin.stamp_s])[0]) @ made.truth.at([answers[-1].stamp_s])[0]
    assert so3.angle((se3.invert(truth) @ turned)[:3, :3]) < np.radians(0.2)


@cache
def turning() -> Drive:
    return drive(((4.0, 0.5, 0.4), (3.0, 0.6, -0.3)))


@cache
def last_without_gyroscope() -> FusedEstimate:
    with pytest.MonkeyPatch.context() as patch:
        return answers_to(joined(patch, turning().eye())[0], turning().events())[-1][1]


@pytest.mark.parametrize(
    ("factor", "said"),
    mostly_slow(
        [(-1.0, "turns the other way"), (180 / np.pi, "degrees"), (0.0, "stays at")], quick=[(180 / np.pi, "degrees")]
    ),
)
def test_a_gyroscope_that_contradicts_the_wheels_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, factor: float, said: str
) -> None:
    made, without = turning(), last_without_gyroscope()
    rates = [YawRate(event.stamp_s, factor * event.yaw_rate_rad_s) for event in yaw_rates(made, 0.01)]
    subject, _ = joined(monkeypatch, made.eye())
    answers, notes = [], []
    for event in sorted([*made.events(), *rates], key=lambda event: event.stamp_s):
        answers.append(subject.process(event))
        notes += [subject.note] if subject.note else []
    last = [answer for answer in answers if answer is not None][-1]
    np.testing.assert_array_equal(last.T_odom_body, without.T_odom_body)
    np.testing.assert_array_equal(last.covariance, without.covariance)
    (note,), (warning,) = notes, subject.warnings
    assert note.startswith("the gyroscope is left out: ")
    assert said in note
    assert said in warning


def test_settings_of_the_filter_reach_it_and_the_one_that_goes_without_the_camera() -> None:
    config = load_config(overrides={**JOINED, "fusion.error_state.clock_sigma_s": 0.003})
    subject = ByFusion(CALIBRATION, config)
    assert subject.filter.parameters.clock_sigma_s == 0.003
    assert subject.filter.begun_at(np.eye(4), np.eye(6)).parameters.clock_sigma_s == 0.003
