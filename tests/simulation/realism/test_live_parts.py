"""Parts that are reported while a robot drives, beside those of a drive that is known before."""

from __future__ import annotations

import numpy as np
import pytest
from small_rooms import room

from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.messages import WheelTicks, YawRate
from wheelsight.core.robots import Duties
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import Realism, RobotModel, realism_of, stream
from wheelsight_sim.body_motion import BodyMotion, BodySettings, LiveBodyMotion
from wheelsight_sim.readings import Delays, StampSettings, as_stamped
from wheelsight_sim.robot import FULL_SPEED_M_S, MOTOR_LAG_S, MOTOR_SPREAD, Motors

PERIOD_S = 0.005
CALM = BodySettings(roll_rad_s=(0.0,) * 6, pitch_rad_s=(0.0,) * 6, yaw_rad_s=(0.0,) * 6)


def braking() -> Trajectory:
    """Two seconds at 1 m/s, then to a stand at 1 m/s²."""
    stamps_s = PERIOD_S * np.arange(800.0)
    speed_m_s = np.clip(3.0 - stamps_s, 0.0, 1.0)
    T = np.tile(np.eye(4), (800, 1, 1))
    T[:, 0, 3] = np.cumsum(speed_m_s) * PERIOD_S
    return Trajectory(stamps_s, T, body="base")


def angles(body: LiveBodyMotion | BodyMotion, stamps_s: FloatArray) -> FloatArray:
    return np.asarray(se3.log(body.T_base_body(stamps_s))[:, [2, 3, 4, 5]])


def realism() -> Realism:
    found = realism_of("real")
    assert found is not None
    return found


def live_angles(settings: BodySettings, truth: Trajectory) -> FloatArray:
    floor = realism().floor_of(room('<geom name="floor" type="plane" size="9 9 1"/>'), 1)
    body = LiveBodyMotion(PERIOD_S, RobotModel(), floor, settings, stream(1, "body"))
    found = []
    for stamp_s, T in truth:
        body.step(T)
        found.append(angles(body, np.array([stamp_s]))[0])
    return np.array(found)


def test_a_live_body_pitches_as_one_that_is_known_before() -> None:
    truth = braking()
    floor = realism().floor_of(room('<geom name="floor" type="plane" size="9 9 1"/>'), 1)
    known = angles(BodyMotion(truth, RobotModel(), floor, CALM, stream(1, "body")), truth.stamps_s)
    live = live_angles(CALM, truth)
    after = slice(300, None)  # the first begins at full speed
    late = 4  # 20 ms
    assert known[after, 2].max() > 0.003
    np.testing.assert_allclose(live[300 + late :, 2], known[300:-late, 2], atol=0.15 * known[after, 2].max())
    np.testing.assert_allclose(live[after][:, [0, 1, 3]], known[after][:, [0, 1, 3]], atol=1e-6)


def test_a_live_body_trembles_as_much_as_one_that_is_known_before() -> None:
    stamps_s = PERIOD_S * np.arange(4000.0)
    T = np.tile(np.eye(4), (4000, 1, 1))
    T[:, 0, 3] = stamps_s
    truth = Trajectory(stamps_s, T, body="base")
    floor = realism().floor_of(room('<geom name="floor" type="plane" size="9 9 1"/>'), 1)
    known = angles(BodyMotion(truth, RobotModel(), floor, BodySettings(), stream(1, "body")), stamps_s)
    live = live_angles(BodySettings(), truth)
    for axis in (1, 2, 3):
        assert live[500:, axis].std() == pytest.approx(known[500:, axis].std(), rel=0.25)  # of 17 s, by chance


def test_delays_are_those_of_a_whole_drive() -> None:
    settings = StampSettings()
    readings = [WheelTicks(0.02 * k, k, k) for k in range(20_000)]
    delays = Delays(settings, np.random.default_rng(1))
    live = np.array([delays.stamped(reading).stamp_s for reading in readings])
    known = np.array([r.stamp_s for r in as_stamped(readings, settings, np.random.default_rng(2))])
    assert (np.diff(live) > 0).all()
    taken_s = 0.02 * np.arange(20_000)
    for percent in (50, 90, 99, 99.8):
        ways = np.percentile(live - taken_s, percent), np.percentile(known - taken_s, percent)
        assert ways[0] == pytest.approx(ways[1], rel=0.1)
    reading = YawRate(0.3, 0.1)
    assert Delays(None, np.random.default_rng(1)).stamped(reading) is reading


def test_motors_come_near_by_an_exponential() -> None:
    motors = Motors()
    speeds = [motors.after(Duties(0.4, -0.2), 0.02) for _ in range(50)]
    share = 1 - np.exp(-0.02 * np.arange(1, 51) / MOTOR_LAG_S)
    expected = np.outer(share, FULL_SPEED_M_S * np.array([0.4, -0.2]))
    np.testing.assert_allclose(speeds, expected, atol=1e-12)
    assert motors.after(Duties(), np.inf) == (0.0, 0.0)
    strong = [Motors(stream(seed, "motors")).after(Duties(1, 1), np.inf) for seed in range(300)]
    assert np.std(strong) == pytest.approx(MOTOR_SPREAD * FULL_SPEED_M_S, rel=0.1)
