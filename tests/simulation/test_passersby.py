from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.plain_kernels import plain
from small_rooms import corridor, looking, room

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, PinholeCamera
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import walking_kernels as kernels
from wheelsight_sim.people import Passersby
from wheelsight_sim.robot import Drive
from wheelsight_sim.scene import Scene


def drive_along(x_m: FloatArray, yaw_rad: FloatArray | float = 0.0) -> Drive:
    """A hundred poses a second."""
    T = np.tile(np.eye(4), (len(x_m), 1, 1))
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1], T[:, 0, 3] = c, -s, s, c, x_m
    return Drive(Trajectory(np.arange(len(x_m)) / 100, T, body="base"), ())


def there_and_back(speed_m_s: float = 1.2) -> Drive:
    out = np.arange(1.0, 22.0, speed_m_s / 100)
    turn = np.linspace(0, np.pi, 300)
    x_m = np.concatenate([out, np.full(300, out[-1]), out[::-1]])
    return drive_along(x_m, np.concatenate([np.zeros(len(out)), turn, np.full(len(out), np.pi)]))


def walked(people: Passersby, drive: Drive) -> FloatArray:
    """(N, K, 2) at all stamps of a drive."""
    return np.stack([people.positions_at(stamp_s) for stamp_s in drive.truth.stamps_s])


def distance_to_chair(drive: Drive, xy_m: FloatArray) -> FloatArray:
    """(N, K) from axes to the outline: 0.3 m behind the axle, 0.8 m before it, 0.3 m to each side."""
    T = drive.truth.T_frame_body
    ahead, left = T[:, None, :2, 0], T[:, None, :2, 1]
    apart = xy_m - T[:, None, :2, 3]
    x, y = (apart * ahead).sum(-1), (apart * left).sum(-1)
    return np.hypot(np.maximum.reduce([-0.3 - x, x - 0.8, 0 * x]), np.maximum(np.abs(y) - 0.3, 0))


@pytest.mark.parametrize("seed", range(4))
def test_people_never_come_nearer_than_60_cm_and_never_into_walls(seed: int) -> None:
    drive = there_and_back()
    people = Passersby(corridor(), drive, 4, seed)
    xy_m = walked(people, drive)
    assert distance_to_chair(drive, xy_m).min() >= 0.6
    assert np.abs(xy_m[..., 1]).max() <= 1.4 - 0.25
    assert np.hypot(xy_m[..., 0] - 9, xy_m[..., 1] - 1.2).min() >= 0.45


def test_people_walk_at_walking_speed_and_pass_the_robot() -> None:
    drive = there_and_back(0.8)
    crossings, ways = 0, []
    for seed in range(3):
        xy_m = walked(Passersby(corridor(), drive, 3, seed), drive)
        speed = np.hypot(*np.diff(xy_m, axis=0).transpose(2, 0, 1)) * 100
        assert speed.max() < 1.61
        ways += (speed / 100).sum(axis=0).tolist()
        behind = np.sign(xy_m[..., 0] - drive.truth.positions_m[:, None, 0])
        crossings += int((np.diff(behind, axis=0) != 0).sum())
    assert np.median(ways) > 0.4 * drive.duration_s
    assert crossings >= 6


def test_people_in_a_dead_end_leave_it_before_they_are_shut_in() -> None:
    # The robot goes to the corridor's end and stays so near to it that no one fits between.
    drive = drive_along(np.concatenate([np.arange(1, 21.5, 0.01), np.full(500, 21.5)]))
    xy_m = walked(Passersby(corridor(ends_m=(22.9,)), drive, 5, 1), drive)
    assert distance_to_chair(drive, xy_m).min() >= 0.6
    assert (xy_m[0, :, 0] > 3).any()
    assert (xy_m[-1, :, 0] < 22.3).all()


def test_where_there_is_no_room_for_people_they_are_refused() -> None:
    fills = drive_along(np.full(300, 3.0))
    closet = corridor(0.7, ((3.0, 0.0), (3.5, 0.0)), ends_m=(2.2, 4.4))
    with pytest.raises(ConfigError, match="no room for passers-by"):
        Passersby(closet, fills, 1, 0)
    with pytest.raises(ConfigError, match="-1 passers-by"):
        Passersby(closet, fills, -1, 0)
    assert Passersby(closet, fills, 0, 0).positions_at(1.0).shape == (0, 2)


def test_loops_have_no_end_to_turn_at() -> None:
    square = replace(room('<geom name="floor" type="plane" size="40 40 1"/>'), is_loop=True)
    square = replace(square, route=np.array([[0.0, 0], [12, 0], [12, 12], [0, 12]]))
    drive = drive_along(np.arange(0, 12, 0.005))
    people = Passersby(square, drive, 6, 2)
    xy_m = walked(people, drive)
    assert distance_to_chair(drive, xy_m).min() >= 0.6
    on_line = np.abs(xy_m - 6).max(axis=-1)
    assert ((on_line > 4) & (on_line < 8)).all()


def test_the_same_seed_makes_the_same_people() -> None:
    drive = there_and_back()
    first, again, other = (Passersby(corridor(), drive, 3, seed) for seed in (5, 5, 6))
    stamps_s = np.linspace(-1, drive.duration_s + 1, 50)
    a, b, c = (np.stack([p.positions_at(stamp_s) for stamp_s in stamps_s]) for p in (first, again, other))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.5
    np.testing.assert_array_equal(a[0], first.positions_at(0.0))
    np.testing.assert_array_equal(a[-1], first.positions_at(drive.duration_s + 0.2))


def test_the_scene_shows_people_where_they_are() -> None:
    drive = drive_along(np.arange(1, 5, 0.01))
    world = corridor()
    people = Passersby(world, drive, 2, 3)
    scene = Scene(world, people)
    assert scene.geoms.names[-2:] == ("passerby0", "passerby1")
    assert set(scene.geoms.materials) <= set(scene.surfaces)
    camera = PinholeCamera(61, 45, 60, 60, 30, 22)
    seen = []
    for stamp_s in (0.0, 1.7, 3.9):
        scene.move_to(stamp_s)
        for i, (x, y) in enumerate(people.positions_at(stamp_s)):
            np.testing.assert_allclose(scene.geoms.position_world[-2 + i], (x, y, 0.85))
            view = scene.cast(camera, looking(x - 1.1, y, 1.0))
            if view.geom[22, 30] == len(scene.geoms.names) - 2 + i:
                seen.append(float(view.depth_m[22, 30]))
    assert len(seen) >= 4
    np.testing.assert_allclose(seen, 0.85, atol=1e-6)
    Scene(world).move_to(1.0)


def test_kernels_do_as_they_are_written(rng: np.random.Generator) -> None:
    slow = plain(kernels)
    clear, same = np.ones((60, 80), np.uint8), np.ones((60, 80), np.uint8)
    c, s = np.cos(0.7), np.sin(0.7)
    arguments = (
        0.1,
        np.array([-1.0, 0.5]),
        np.array([2.0, 3.1]),
        np.array([[c, -s], [s, c]]),
        np.array([-0.3, 0.8, 0.3]),
    )
    kernels.keep_clear(clear, *arguments, 0.7)
    slow.keep_clear(same, *arguments, 0.7)
    np.testing.assert_array_equal(clear, same)
    # The outline's area, 0.7 m round it, and round corners.
    area = 1.1 * 0.6 + 0.7 * 2 * (1.1 + 0.6) + np.pi * 0.7**2
    assert 0.01 * (clear == 0).sum() == pytest.approx(area, rel=0.03)
    along, left = np.meshgrid(np.arange(80) * 0.1, np.arange(60) * 0.1 - 3)
    steps = np.argwhere(np.ones((5, 5))) - 2
    others = np.array([[22, 30]])
    route = kernels.RouteGrid(along, left, 8.0)
    for _ in range(20):
        row, column = rng.integers(0, (60, 80))
        step = (clear, route, steps, row, column, kernels.Wish(0.2, 0.4), others, 8.0)
        assert kernels.best_step(*step) == slow.best_step(*step)
    ahead = kernels.Wish(0.2, 0.0)
    assert kernels.best_step(np.ones_like(clear), route, steps, 30, 79, ahead, others, 8.0) == (30, 79)
    assert kernels.best_step(np.zeros_like(clear), route, steps, 30, 40, ahead, others, 8.0) == (-1, -1)
