from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely

from wheelsight.core.errors import ConfigError, InputError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight_sim.drivers import (
    COMMAND_PERIOD_S,
    Command,
    Driver,
    ManualVelocities,
    StopAndTurn,
    follow_route,
    read_manual_velocities,
)

LOOP = np.array([(0, 0), (12, 0), (12, 8), (7, 8), (6, 5), (0, 8)], float)


def driven(driver: Driver, limit_s: float = 300.0) -> tuple[FloatArray, list[Command]]:
    """x, y, yaw (N, 3) of a robot that does at once what it is reported, and the commands it was given."""
    assert driver.T_world_start is not None
    x, y, yaw = driver.T_world_start[0, 3], driver.T_world_start[1, 3], None
    yaw = math.atan2(driver.T_world_start[1, 0], driver.T_world_start[0, 0])
    states: list[tuple[float, float, float]] = [(x, y, yaw)]
    commands: list[Command] = []
    for i in range(round(limit_s / COMMAND_PERIOD_S)):
        command = driver.command(i * COMMAND_PERIOD_S, se3.from_plane(x, y, yaw))
        if command is None:
            return np.array(states), commands
        turn = command.yaw_rate_rad_s * COMMAND_PERIOD_S
        x += command.v_m_s * COMMAND_PERIOD_S * math.cos(yaw + turn / 2)
        y += command.v_m_s * COMMAND_PERIOD_S * math.sin(yaw + turn / 2)
        yaw += turn
        states.append((x, y, yaw))
        commands.append(command)
    raise AssertionError("the driver never arrived")


@pytest.mark.parametrize("speed_m_s", [0.4, 1.2])
def test_a_route_is_kept_to_and_ends_where_it_should(speed_m_s: float) -> None:
    states, commands = driven(follow_route(LOOP, is_loop=True, speed_m_s=speed_m_s))
    legs = shapely.LineString([*LOOP, LOOP[0]])
    assert shapely.distance(legs, shapely.points(states[:, :2])).max() < 0.13
    assert np.hypot(*states[-1, :2]) < 0.02
    assert max(command.v_m_s for command in commands) == pytest.approx(speed_m_s, rel=1e-3)
    assert all(shapely.distance(shapely.Point(corner), shapely.LineString(states[:, :2])) < 0.3 for corner in LOOP)


def test_speeds_change_no_faster_than_a_rider_can_bear() -> None:
    for driver in (follow_route(LOOP, is_loop=True), StopAndTurn(LOOP, 1.0)):
        _, commands = driven(driver)
        v = np.array([(command.v_m_s, command.yaw_rate_rad_s) for command in commands])
        rates = np.abs(np.diff(v, axis=0)) / COMMAND_PERIOD_S
        assert (rates.max(axis=0) <= [0.75 + 1e-9, 1.5 + 1e-9]).all()
        assert np.abs(v[-1]).max() < 0.05


def test_laps() -> None:
    once, _ = driven(follow_route(LOOP, is_loop=True))
    twice, _ = driven(follow_route(LOOP, is_loop=True, laps=2))
    assert once[-1, 2] - once[0, 2] == pytest.approx(1.5 * np.pi, abs=0.02)
    assert twice[-1, 2] - once[-1, 2] == pytest.approx(2 * np.pi, abs=0.02)


def test_a_route_that_is_no_loop_is_driven_back_after_a_turn_on_the_spot() -> None:
    states, commands = driven(follow_route([(0, 0), (5, 0), (5, 3)], is_loop=False, laps=2))
    assert np.hypot(*states[-1, :2]) < 0.03
    assert states[:, 1].max() == pytest.approx(3.0, abs=0.03)
    turning = [c for c in commands if abs(c.v_m_s) < 0.05 and abs(c.yaw_rate_rad_s) > 0.3]
    assert len(turning) * COMMAND_PERIOD_S > 2.0


def test_stop_and_turn_stops_at_each_waypoint_and_turns_there() -> None:
    square = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)], float)
    states, commands = driven(StopAndTurn(square))
    legs = shapely.LineString(square)
    assert shapely.distance(legs, shapely.points(states[:, :2])).max() < 0.01
    assert states[-1, 2] == pytest.approx(2 * np.pi, abs=0.005)
    turning = np.array([abs(command.yaw_rate_rad_s) > 0.1 for command in commands])
    assert max(abs(c.v_m_s) for c, turns in zip(commands, turning, strict=True) if turns) < 0.03
    assert np.count_nonzero(np.diff(turning.astype(int)) == 1) == 4
    straight, _ = driven(StopAndTurn(square, final_turn=False))
    assert straight[-1, 2] == pytest.approx(1.5 * np.pi, abs=0.005)


def test_manual_velocities_hold_until_the_next() -> None:
    driver = ManualVelocities([1.0, 2.0, 3.0], [0.5, -0.2, 0.0], [0.0, 0.1, 0.0])
    here = np.eye(4)
    assert driver.command(0.5, here) == Command(0.0, 0.0)
    assert driver.command(1.0, here) == driver.command(1.98, here) == Command(0.5, 0.0)
    assert driver.command(2.0, here) == Command(-0.2, 0.1)
    assert driver.command(3.0, here) is None
    assert driver.T_world_start is None


def test_velocities_come_from_a_table(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("stamp_s,v_m_s,yaw_rate_rad_s\n0,0.5,0\n2.5,0.2,-0.3\n# the end\n4,0,0\n")
    driver = read_manual_velocities(path)
    assert driver.command(3.0, np.eye(4)) == Command(0.2, -0.3)
    assert driver.command(4.0, np.eye(4)) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stamp_s,v_m_s\n0,1\n", ("drive.csv:1", "yaw_rate_rad_s")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,fast,0\n1,0,0\n", ("drive.csv:2", "v_m_s", "fast")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,0\n1,0\n", ("drive.csv:3",)),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,0\n1,1.3,0\n2,0,0\n", ("drive.csv:3", "v_m_s is 1.3", "1.2")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,-7\n1,0,0\n", ("drive.csv:2", "yaw_rate_rad_s is -7")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,nan\n1,0,0\n", ("drive.csv:2", "yaw_rate_rad_s")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n1,1,0\n0,0,0\n", ("drive.csv:3", "stamp_s is 0")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n-1,1,0\n0,0,0\n", ("drive.csv:2", "stamp_s is -1")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,0\n", ("drive.csv", "fewer than two rows")),
        ("stamp_s,v_m_s,yaw_rate_rad_s\n0,1,0\n1,0,0", ("drive.csv:3", "does not end")),
    ],
)
def test_a_bad_table_is_refused_by_file_line_and_column(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "drive.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_manual_velocities(path)
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_a_table_that_is_missing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv"):
        read_manual_velocities(tmp_path / "none.csv")


@pytest.mark.parametrize("speed_m_s", [1.21, 0.0, -0.5, math.nan, math.inf])
def test_speeds_over_a_walk_are_refused(speed_m_s: float) -> None:
    with pytest.raises(ConfigError, match=r"1\.2 m/s"):
        follow_route(LOOP, is_loop=True, speed_m_s=speed_m_s)
    with pytest.raises(ConfigError, match=r"1\.2 m/s"):
        StopAndTurn(LOOP, speed_m_s)


@pytest.mark.parametrize(
    ("route", "options"),
    [
        ([(0, 0)], {"is_loop": False}),
        ([(0, 0), (1, 0)], {"is_loop": True}),
        ([(0, 0), (0, 0), (1, 0)], {"is_loop": False}),
        ([(0, 0), (1, 0), (1, 1), (0, 0)], {"is_loop": True}),
        ([(0, 0), (1, math.nan)], {"is_loop": False}),
        ([(0, 0), (1, 0)], {"is_loop": False, "laps": 0}),
    ],
)
def test_routes_that_are_none_are_refused(route: list[tuple[float, float]], options: dict[str, bool]) -> None:
    with pytest.raises(ConfigError):
        follow_route(route, **options)
