"""The default filter's gyroscope: at any rate it shows the same slips, and of hardly any that is none."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from narrowing import not_none

from wheelsight.core.calibration_parts import Gyro
from wheelsight.core.estimates import MotionEstimate, Reason
from wheelsight.core.geometry import se3
from wheelsight.estimation import ErrorStateFilter, FusedEstimate

WHEEL_HZ, FRAME_HZ, NOISE = 50, 30, 1e-3
LOOK_SIGMAS = np.array([2e-3] * 3 + [1e-3] * 3)
RATES_HZ = (50, 100, 400, 1000)


def ridden(
    gyro_hz: int,
    seed: int,
    *,
    seconds: float = 10.0,
    speed_m_s: float = 0.0,
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bias_rad_s: float = 0.0,
    gyro: Gyro | None = None,
    sees: bool = True,
) -> tuple[ErrorStateFilter, list[FusedEstimate]]:
    """Answers to frames and wheels of a base that goes straight on; its wheels turn by spin[2] rad/s from spin[0] to
    spin[1]. The camera measurements at where it began, where it goes nowhere.
    """
    rng, fusion = np.random.default_rng(seed), ErrorStateFilter(np.eye(4), gyro=gyro)
    events = [(i / gyro_hz + 1e-4, "gyro") for i in range(1, int(seconds * gyro_hz))]
    events += [(i / WHEEL_HZ, "wheels") for i in range(1, int(seconds * WHEEL_HZ))]
    events += [(i / FRAME_HZ + 3e-3, "frame") for i in range(1, int(seconds * FRAME_HZ)) if sees]
    fusion.clone(0.0, "begin")
    answers, way_m = [], speed_m_s / WHEEL_HZ
    Q = np.diag([0.01**2 * way_m / 2, 0, 0, 0, 0, 0.01**2 * way_m * 2 / 0.52**2])
    for stamp_s, kind in sorted(events):
        if kind == "gyro":
            fusion.update_yaw_rate(stamp_s, bias_rad_s + NOISE * np.sqrt(gyro_hz) * rng.standard_normal())
        elif kind == "wheels":
            turned = spin[2] / WHEEL_HZ if spin[0] < stamp_s - 0.5 / WHEEL_HZ < spin[1] else 0.0
            step = np.array([way_m, 0, 0, 0, 0, turned]) + np.sqrt(np.diag(Q)) * rng.standard_normal(6)
            answers.append(fusion.predict(stamp_s, se3.exp(step), Q, stamp_s - 1 / WHEEL_HZ))
        else:
            seen = MotionEstimate(
                se3.exp(LOOK_SIGMAS * rng.standard_normal(6)), np.diag(LOOK_SIGMAS**2), None, 200, 160
            )
            answers.append(fusion.update_relative(stamp_s, seen, "begin"))
    return fusion, answers


def yaw_of(answer: FusedEstimate) -> float:
    assert answer.T_odom_body is not None
    return float(np.arctan2(answer.T_odom_body[1, 0], answer.T_odom_body[0, 0]))


def share_of_slips(gyro_hz: int, seeds: int, **ride: Any) -> float:
    answers = [answer for seed in range(100, 100 + seeds) for answer in ridden(gyro_hz, seed, **ride)[1]]
    return float(np.mean([answer.slip for answer in answers]))


@pytest.mark.slow
@pytest.mark.parametrize("gyro_hz", [RATES_HZ[0], RATES_HZ[-1]])
def test_at_rest_there_is_hardly_any_slip_that_is_none(gyro_hz: int) -> None:
    """However often it shows: it was a quarter of the frames at 1000 Hz."""
    assert share_of_slips(gyro_hz, 4, bias_rad_s=0.01) <= 0.005


@pytest.mark.slow
@pytest.mark.parametrize(("gyro_hz", "seeds", "limit"), [(RATES_HZ[0], 20, 0.005), (RATES_HZ[-1], 4, 0.01)])
def test_on_the_way_too(gyro_hz: int, seeds: int, limit: float) -> None:
    """A false slip lasts for 15 answers, and 3 came in 140 rides at 50 Hz: 3 are allowed in 20, and 1 in 4."""
    assert share_of_slips(gyro_hz, seeds, speed_m_s=0.5, sees=False) <= limit


@pytest.mark.parametrize("gyro_hz", RATES_HZ)
def test_wheels_that_spin_are_found_out_and_do_not_turn_the_base(gyro_hz: int) -> None:
    """By a radian in a second."""
    known = Gyro(bias_sigma_rad_s=1e-3)
    for seed in range(2):
        spin: dict[str, Any] = {"speed_m_s": 0.5, "spin": (3.0, 4.0, 1.0), "sees": False, "gyro": known}
        _, answers = ridden(gyro_hz, seed, seconds=6.0, **spin)
        reported = [answer.stamp_s for answer in answers if answer.slip]
        assert 3.0 < reported[0] < 3.1
        assert sum(3.0 < stamp_s < 4.3 for stamp_s in reported) > 50
        assert abs(yaw_of(answers[-1])) < 0.1


@cache
def sigmas_at(gyro_hz: int) -> list[float]:
    fusion, answers = ridden(gyro_hz, 1, speed_m_s=0.5, sees=False)
    belief = fusion.state.detection.primary
    return [*np.sqrt([not_none(answers[-1].covariance)[5, 5], *np.diag(belief.covariance)[[-1, -13]]])]


@pytest.mark.parametrize("gyro_hz", RATES_HZ[1:])
def test_the_wheels_are_as_well_known_at_any_rate_of_its_readings(gyro_hz: int) -> None:
    """Of a step of the wheels it shows once, and not as often as it is read."""
    np.testing.assert_allclose(sigmas_at(gyro_hz), sigmas_at(RATES_HZ[0]), rtol=0.15)


@pytest.mark.parametrize("bias_rad_s", [0.1, -0.1])
def test_a_bias_that_was_stated_does_not_turn_the_base(bias_rad_s: float) -> None:
    """It was ignored: 14.6° in these 10 s."""
    stated = Gyro(bias_rad_s=bias_rad_s, bias_sigma_rad_s=1e-3)
    for seed in range(3):
        _, answers = ridden(100, seed, speed_m_s=0.5, bias_rad_s=bias_rad_s, gyro=stated, sees=False)
        assert abs(yaw_of(answers[-1])) < np.radians(1.0)  # 1e-3 rad/s for 10 s are 0.6°
        assert not any(answer.slip for answer in answers)


def test_a_bias_that_is_kept_stays() -> None:
    kept = Gyro(bias_rad_s=0.1, bias_sigma_rad_s=0.0, bias_walk_rad_s_per_sqrt_s=0.0)
    fusion, answers = ridden(100, 1, speed_m_s=0.5, bias_rad_s=0.1, gyro=kept, sees=False)
    assert fusion.state.detection.primary.gyro_bias_rad_s == 0.0
    assert abs(yaw_of(answers[-1])) < np.radians(0.5)


def test_a_bias_found_elsewhere_counts_once() -> None:
    """The finder started from the same belief: 0.1 ± 0.02 rad/s before, 0.13 ± 0.01 after all that was reported."""
    fusion = ErrorStateFilter(gyro=Gyro(bias_rad_s=0.1, bias_sigma_rad_s=0.02))
    fusion.predict(0.1, np.eye(4), 1e-6 * np.eye(6), 0.0)
    assert fusion.update_gyro_bias(0.1, 0.13, 0.01).reason is None
    belief = fusion.state.detection.primary
    assert belief.gyro_bias_rad_s == pytest.approx(0.03, rel=1e-3)
    assert np.sqrt(belief.covariance[-1, -1]) == pytest.approx(0.01, rel=1e-3)


@pytest.mark.parametrize(("bias", "sigma"), [(np.nan, 0.01), (0.1, 0.0), (0.1, 0.02), (0.1, -1.0), (0.1, np.nan)])
def test_a_bias_that_shows_nothing_is_refused(bias: float, sigma: float) -> None:
    fusion = ErrorStateFilter()
    fusion.predict(0.1, np.eye(4), 1e-6 * np.eye(6), 0.0)
    assert fusion.update_gyro_bias(0.1, bias, sigma).reason is Reason.INVALID


def test_readings_that_come_before_the_wheels_tell_of_their_time_end_alike() -> None:
    """As live: the reading of the wheels is the last to come of all that its step saw."""
    in_order, late = ErrorStateFilter(), ErrorStateFilter()
    Q = np.diag([1e-6, 0, 0, 0, 0, 1e-5])
    for i in range(40):
        begin_s, end_s = 0.02 * i, 0.02 * (i + 1)
        for fusion, wheels_first in ((in_order, True), (late, False)):
            if wheels_first:
                fusion.predict(end_s, se3.exp([0.01, 0, 0, 0, 0, 0.004]), Q, begin_s)
            for j in range(1, 20):
                fusion.update_yaw_rate(begin_s + 1e-3 * j, 0.25)
            if not wheels_first:
                fusion.predict(end_s, se3.exp([0.01, 0, 0, 0, 0, 0.004]), Q, begin_s)
    T, expected = late.estimate.T_odom_body, in_order.estimate.T_odom_body
    assert T is not None
    np.testing.assert_allclose(T, not_none(expected), atol=1e-12)
    np.testing.assert_allclose(not_none(late.estimate.covariance), not_none(in_order.estimate.covariance), atol=1e-12)
