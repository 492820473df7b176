from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from simulation.planes import WALL, by_wheels, plane, yaws_rad

from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import se3
from wheelsight_calibration.squares import SquareRun, corrected, umbmark_from_runs
from wheelsight_calibration.wheel_drive import drive_from_ticks
from wheelsight_sim import Realism
from wheelsight_sim.drivers import ManualVelocities, StopAndTurn, follow_route
from wheelsight_sim.physics import simulate_drive
from wheelsight_sim.robot import Drive, Patch, RobotModel, WheelFaults
from wheelsight_sim.wheelchair import Chair

ROBOT = RobotModel()
WORLD = plane()
SQUARE = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)], float)


def robot_with(wheels: Wheels) -> RobotModel:
    return RobotModel(wheels.left_radius_m, wheels.right_radius_m, wheels.track_width_m)


def straight(seconds: float = 6.0, v_m_s: float = 0.5) -> ManualVelocities:
    return ManualVelocities([0.0, seconds, seconds + 1], [v_m_s, 0.0, 0.0], [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    "robot", [ROBOT, robot_with(corrected(ROBOT.wheels, 1.01, 0.97))], ids=["nominal", "odd wheels"]
)
def test_without_slip_true_wheels_close_to_a_thousandth(robot: RobotModel) -> None:
    drive = simulate_drive(WORLD, robot, follow_route(WORLD.route, is_loop=True, laps=2, speed_m_s=1.2), slip=False)
    path, truth = by_wheels(drive, robot.wheels)
    errors_m = np.linalg.norm(path.positions_m - truth[:, :3, 3], axis=1)
    assert drive.is_complete
    assert not drive.reason
    assert drive.truth.length_m == pytest.approx(2 * 20, rel=0.05)
    assert errors_m[-1] < 1e-3 * drive.truth.length_m
    assert errors_m.max() < 0.02
    assert np.abs(yaws_rad(path.T_frame_body) - yaws_rad(truth)).max() < 0.01


@pytest.mark.slow
def test_in_a_bend_the_outer_tyre_is_pressed_in_and_turns_further() -> None:
    """130 kg, 0.42 m high, at 0.48 m/s² across 0.52 m: 50 N change sides, two thirds of them on the driven wheels."""
    bend = ManualVelocities([0.0, 14.0, 15.0], [0.8, 0.0, 0.0], [0.6, 0.0, 0.0])
    ideal, real = (
        simulate_drive(WORLD, ROBOT, bend, seed=2, realism=realism, time_limit_s=13.0) for realism in (None, Realism())
    )
    np.testing.assert_allclose(real.truth.positions_m[-1], ideal.truth.positions_m[-1], atol=1e-6)
    left, right = (
        (getattr(real.ticks[-1], side) - getattr(real.ticks[200], side))
        / (getattr(ideal.ticks[-1], side) - getattr(ideal.ticks[200], side))
        for side in ("left", "right")
    )
    expected = 0.4 * 50 * 0.67 / 80_000 / 0.17
    assert right - 1 == pytest.approx(expected, rel=0.5)  # the bend is to the left
    assert 1 - left == pytest.approx(expected, rel=0.5)


@pytest.mark.slow
def test_with_slip_what_turns_do_to_the_heading_outweighs_what_straights_do_to_the_way() -> None:
    """Each corner turns the rest of the lap by its error; ten metres of straight only lengthen themselves."""
    turned_m, straight_m = [], []
    for seed in range(3):
        drive = simulate_drive(WORLD, ROBOT, follow_route(WORLD.route, is_loop=True), seed=seed)
        path, truth = by_wheels(drive, ROBOT.wheels)
        off_rad = yaws_rad(path.T_frame_body) - yaws_rad(truth)
        steps_m = np.diff(truth[:, :2, 3], axis=0) @ np.array([1, 1j])
        turned_m.append(abs(np.sum(steps_m * (np.exp(1j * off_rad[1:]) - 1))))
        is_straight = np.abs(np.diff(yaws_rad(truth))) < 0.002
        straight_m.append(
            abs(np.sum((np.abs(np.diff(path.positions_m[:, :2] @ [1, 1j])) - np.abs(steps_m))[is_straight]))
        )
    assert np.median(turned_m) > 2 * np.median(straight_m)
    assert 0.01 < np.median(turned_m) < 0.5


def test_the_way_on_the_spot_is_no_way_and_its_error_is_of_heading() -> None:
    turn = ManualVelocities([0.0, 10.5, 11.5], [0.0, 0.0, 0.0], [0.6, 0.0, 0.0])
    drive = simulate_drive(WORLD, ROBOT, turn)
    path, truth = by_wheels(drive, ROBOT.wheels)
    assert yaws_rad(truth)[-1] == pytest.approx(6.3, rel=0.03)
    slip_rad = yaws_rad(path.T_frame_body)[-1] - yaws_rad(truth)[-1]
    assert 1e-4 < slip_rad < 0.05, "castors drag, so that wheels turn more than the wheelchair"
    assert np.linalg.norm(truth[-1, :2, 3]) < 0.02


def square_run(robot: RobotModel, sense: int, seed: int, *, slip: bool = True) -> SquareRun:
    driver = StopAndTurn(SQUARE * (1, sense), is_blind=True)
    drive = simulate_drive(WORLD, robot, driver, seed=seed, slip=slip)
    assert drive.is_complete
    stamps_s, left, right = np.array([(t.stamp_s, t.left, t.right) for t in drive.ticks]).T
    T_start_end = np.linalg.inv(drive.truth.T_frame_body[0]) @ drive.truth.T_frame_body[-1]
    turned = drive_from_ticks(robot.nominal, stamps_s, left, right)
    return SquareRun(f"{sense}-{seed}", turned, 0.0, float(stamps_s[-1]), T_start_end[:2, 3])


@pytest.mark.parametrize(
    ("slip", "seeds"),
    [(False, (0,)), pytest.param(True, (1, 2, 3, 4, 5), marks=pytest.mark.slow)],
    ids=["no slip", "slip"],
)
def test_umbmark_finds_the_wheels_that_were_built_in(slip: bool, seeds: tuple[int, ...]) -> None:
    wheels = corrected(ROBOT.wheels, 1.006, 1.012)
    runs = [square_run(robot_with(wheels), sense, seed, slip=slip) for sense in (-1, 1) for seed in seeds]
    found = umbmark_from_runs(ROBOT.nominal, runs, side_m=4.0)
    assert found.diameter_ratio == pytest.approx(1.006, rel=0.002 if slip else 1e-4)
    assert found.track_factor == pytest.approx(1.012, rel=0.002 if slip else 1e-4)
    scatter_m = [np.ptp(errors, axis=0).max() for errors in (found.clockwise_m, found.counter_clockwise_m)]
    assert all(0.005 < m < 0.3 for m in scatter_m) if slip else max(scatter_m) == 0


def test_castors_swivel_when_the_wheelchair_backs_up() -> None:
    chair = Chair(WORLD, ROBOT, WheelFaults(), np.eye(4), slip=True, rng=np.random.default_rng(1))
    chair.settle(0.5)
    swivels_rad = []
    for v_m_s in (0.5, -0.5):
        for i in range(200):
            chair.obey(v_m_s, 0.1)
            chair.step(i * 0.02, 8)
        swivels_rad.append(np.cos(chair.swivels_rad))
    assert (swivels_rad[0] > 0.98).all(), "they trail behind a wheelchair that goes forward"
    assert (swivels_rad[1] < -0.95).all(), "and have gone round when it backs up"


def test_counts_are_what_the_wheels_turned() -> None:
    drive = simulate_drive(WORLD, ROBOT, straight(), slip=False)
    rolled_m = np.array([t.left for t in drive.ticks]) / 3200 * 2 * math.pi * 0.17
    x_m = drive.truth.at([t.stamp_s for t in drive.ticks])[:, 0, 3]
    np.testing.assert_allclose(rolled_m, x_m, atol=2 * 0.17 * math.pi * 2 / 3200)
    np.testing.assert_allclose(np.diff([t.stamp_s for t in drive.ticks]), 0.02, atol=1e-9)


def test_ice_makes_wheels_slip() -> None:
    ice = WheelFaults(patches=(Patch(2.0, 0.0, 0.8, friction=0.05),))
    errors_m = []
    for faults in (WheelFaults(), ice):
        drive = simulate_drive(WORLD, ROBOT, StopAndTurn(SQUARE[:3] / 2, 1.0), faults=faults, seed=1)
        path, truth = by_wheels(drive, ROBOT.wheels)
        errors_m.append(np.linalg.norm(path.positions_m[-1] - truth[-1, :3, 3]))
    assert errors_m[1] > 5 * errors_m[0]
    assert errors_m[1] > 0.1


def test_a_lifted_wheel_spins_and_does_not_drive() -> None:
    drive = simulate_drive(WORLD, ROBOT, straight(8.0), faults=WheelFaults(lifted_s=((3.0, 5.0),)))
    before, during, after = drive.truth.at([2.5, 4.8, 6.5])
    assert abs(math.atan2(before[1, 0], before[0, 0])) < 0.02
    assert during[2, 1] == pytest.approx(0.01 / 0.26 / 2, rel=0.3), "its end of the axle is a centimetre higher"
    assert math.atan2(during[1, 0], during[0, 0]) > 0.5, "the right wheel drives round the left one"
    assert after[2, 1] == pytest.approx(0, abs=1e-3)
    left = np.array([t.left for t in drive.ticks if 3.5 < t.stamp_s < 5.0])
    assert np.diff(left).mean() * 50 == pytest.approx(0.5 / 0.17 * 3200 / (2 * math.pi), rel=0.02)


def test_dropouts_and_an_unplugged_cable_reach_the_readings() -> None:
    faults = WheelFaults(dropouts_s=((1.0, 1.5),), unplugged_s=((3.0, 4.0),))
    whole, broken = (simulate_drive(WORLD, ROBOT, straight(), faults=f) for f in (WheelFaults(), faults))
    assert len(whole.ticks) - len(broken.ticks) == 25
    np.testing.assert_array_equal(whole.truth.T_frame_body, broken.truth.T_frame_body)
    lost = whole.ticks[-1].left - broken.ticks[-1].left
    assert lost == pytest.approx(0.5 * 3200 / (2 * math.pi * 0.17), rel=0.02)


def same(a: Drive, b: Drive) -> bool:
    return a.truth.T_frame_body.tobytes() == b.truth.T_frame_body.tobytes() and (a.ticks, a.yaw_rates) == (
        b.ticks,
        b.yaw_rates,
    )


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others() -> None:
    first, again, other = (simulate_drive(WORLD, RobotModel(has_gyro=True), straight(2.0), seed=s) for s in (7, 7, 8))
    assert same(first, again)
    assert not same(first, other)


def test_a_wheelchair_against_a_wall_is_stuck_and_says_where() -> None:
    drive = simulate_drive(plane(extra=WALL), ROBOT, follow_route([(0, 0), (6, 0)], is_loop=False))
    assert not drive.is_complete
    assert drive.reason.startswith("stuck at x = 2.10")
    assert drive.truth.positions_m[:, 0].max() < 2.12, "the wall begins at 2.9 m, the hull ends 0.8 m ahead"
    assert drive.duration_s < 20


def test_physics_that_runs_away_ends_the_drive_and_leaves_no_pose_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    step = Chair.step

    def explode(self: Chair, stamp_s: float, steps: int) -> None:
        step(self, stamp_s, steps)
        if stamp_s > 1.0:
            self._data.qvel[:] = 1e5

    monkeypatch.setattr(Chair, "step", explode)
    drive = simulate_drive(WORLD, ROBOT, straight(), time_limit_s=5.0)
    assert not drive.is_complete
    assert "unstable" in drive.reason
    assert np.abs(drive.truth.positions_m).max() < 1.0


def test_a_time_limit_ends_a_drive() -> None:
    reported_s: list[float] = []
    drive = simulate_drive(WORLD, ROBOT, straight(60.0), time_limit_s=3.0, on_progress=reported_s.append)
    assert not drive.is_complete
    assert "time limit of 3 s" in drive.reason
    assert drive.duration_s == pytest.approx(3.0, abs=0.01)
    assert reported_s == pytest.approx([0, 1, 2, 3])


@pytest.mark.parametrize("time_limit_s", [0.0, -1.0, math.nan, math.inf])
def test_a_time_limit_that_is_none_is_refused(time_limit_s: float) -> None:
    with pytest.raises(ConfigError, match="time_limit_s"):
        simulate_drive(WORLD, ROBOT, straight(), time_limit_s=time_limit_s)


def test_standing_still_is_not_being_stuck() -> None:
    wait = ManualVelocities([0.0, 12.0, 13.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    drive = simulate_drive(WORLD, ROBOT, wait)
    assert drive.is_complete
    assert drive.truth.length_m < 0.01
    assert max(abs(t.left) for t in drive.ticks) < 10, "a few counts by a floor that is not level"


def test_truth_is_of_the_base_at_200_hz_and_starts_where_the_route_does() -> None:
    world = plane(route=[(1, 2), (1, 5)])
    drive = simulate_drive(world, ROBOT, straight(1.0))
    np.testing.assert_allclose(np.diff(drive.truth.stamps_s), 0.005, atol=1e-9)
    assert drive.truth.body == "base"
    assert drive.truth.stamps_s[0] == 0
    np.testing.assert_allclose(drive.truth.T_frame_body[0], se3.from_plane(1, 2, np.pi / 2), atol=1e-3)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda: WheelFaults(lifted_s=((3.0, 2.0),)), "lifted_s"),
        (lambda: WheelFaults(dropouts_s=((-1.0, 2.0),)), "dropouts_s"),
        (lambda: WheelFaults(unplugged_s=((math.nan, 2.0),)), "unplugged_s"),
        (lambda: Patch(0.0, 0.0, -1.0), "radius -1"),
        (lambda: Patch(math.nan, 0.0, 1.0), "nan"),
        (lambda: Patch(0.0, 0.0, 1.0, friction=0.0), "friction is 0"),
    ],
)
def test_faults_that_cannot_be_are_refused(fault: Callable[[], object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        fault()
