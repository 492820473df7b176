"""Shadows where geometry has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from odometry.plain_kernels import plain
from small_rooms import WHITE, looking, room

from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import light_kernels as kernels
from wheelsight_sim.appearance import Shadows, ShadowSettings, lighting_of
from wheelsight_sim.doors import Doors
from wheelsight_sim.robot import Drive
from wheelsight_sim.scene import Scene
from wheelsight_sim.world import Leaf

CAMERA = PinholeCamera(160, 120, 130, 130, 79.5, 59.5)
LAMP_M, HALF_M = np.array([0.0, 0.0, 2.8]), (0.3, 0.3)
# A board of 1 m under the lamp, its top at 0.75 m.
BOARD = np.array([0.0, 0.0, 0.70, 0.75, 1.0, 0.0, 0.5, 0.5])
PAINTS = {"white": WHITE, "lamp": replace(WHITE, glow=5.0)}
FLOOR = '<geom name="floor" type="plane" size="6 6 1"/>'
LAMP = '<geom name="lamp" type="box" pos="3 0 2.8" size="0.3 0.3 0.02" material="lamp"/>'


def covered(p: FloatArray, box: FloatArray, is_round: bool = False, module: object = kernels) -> float:
    d = LAMP_M - p
    level = float(np.hypot(d[0], d[1]))
    return float(module.covered(tuple(p), tuple(d), level, HALF_M, box, is_round))  # type: ignore[attr-defined]


def test_a_boards_shadow_ends_where_lines_from_the_lamp_over_its_edge_meet_the_floor() -> None:
    for place_m, share in ((-0.3, 0.0), (-0.15, 0.25), (0.0, 0.5), (0.15, 0.75), (0.3, 1.0)):
        # From x on the floor, the line to this place of the lamp passes the board's upper edge.
        x = (0.5 - place_m * 0.75 / 2.8) / (1 - 0.75 / 2.8)
        assert covered(np.array([x, 0.0, 0.0]), BOARD) == pytest.approx(share, abs=1e-9)
    assert covered(np.array([0.2, -0.2, 0.0]), BOARD) == 1.0
    assert covered(np.array([0.0, 0.0, 0.8]), BOARD) == 0.0


def test_corners_of_boards_are_as_exact(rng: np.random.Generator) -> None:
    thin = BOARD.copy()
    thin[2] = 0.749
    off = [abs(covered(p, thin) - by_rays(p, thin)) for p in rng.uniform([0, 0, 0], [1.2, 1.2, 0.3], (50, 3))]
    assert max(off) < 0.02


def by_rays(p: FloatArray, box: FloatArray, count: int = 100) -> float:
    """The same by rays to a grid of places on the lamp."""
    steps = (np.arange(count) + 0.5) / count * 2 - 1
    x, y = np.meshgrid(steps * HALF_M[0], steps * HALF_M[1])
    d = LAMP_M + np.stack([x, y, 0 * x], axis=-1) - p
    c, s = box[4], box[5]
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    origin = turn @ (p - [box[0], box[1], (box[2] + box[3]) / 2])
    half = np.array([box[6], box[7], (box[3] - box[2]) / 2])
    d = d @ turn.T
    near, far = np.sort([(-half - origin) / d, (half - origin) / d], axis=0)
    return float((np.maximum(near.max(-1), 0) < np.minimum(far.min(-1), 1)).mean())


def test_turned_boxes_are_near_what_many_rays_tell(rng: np.random.Generator) -> None:
    off = []
    for _ in range(400):
        yaw, low = rng.uniform(0, np.pi), rng.uniform(0, 1)
        middle, half = rng.uniform(-1, 1, 2), rng.uniform(0.02, 0.6, 2)
        box = np.array([*middle, low, low + rng.uniform(0.05, 1.2), np.cos(yaw), np.sin(yaw), *half])
        p = np.array([*rng.uniform(-1.5, 1.5, 2), 0.0])
        if low > 0.05:
            off.append(covered(p, box) - by_rays(p, box))
            assert covered(p, box) == pytest.approx(covered(p, box, module=plain(kernels)), abs=1e-12)
    assert abs(np.mean(off)) < 0.02
    assert np.sqrt(np.mean(np.square(off))) < 0.06


def test_a_round_things_shadow_is_as_wide_as_it_is_from_any_side() -> None:
    post = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.25, 0.25])
    shares = []
    for yaw in np.linspace(0, 2 * np.pi, 7):
        ahead, aside = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0])
        p = 2.0 * ahead
        shares.append([float(kernels.covered(tuple(p + y * aside), tuple(-3 * ahead - y * aside + [0, 0, 9]),
                       np.hypot(3, y), (1e-6, 1e-6), post, True)) for y in (0.0, 0.2, 0.4)])  # fmt: skip
    np.testing.assert_allclose(shares, [shares[0]] * 7, atol=1e-6)


def shadows_in(geoms: str, *, has_robot: bool = False) -> tuple[Scene, Shadows]:
    scene = Scene(room(FLOOR + LAMP + geoms, PAINTS), threads=1)
    return scene, shadows_of(scene, has_robot=has_robot)


def shadows_of(scene: Scene, strength: float = 0.6, *, has_robot: bool = False) -> Shadows:
    lighting = lighting_of(scene.geoms, [scene.surfaces[material] for material in scene.geoms.materials], 0)
    return Shadows(ShadowSettings(strength), scene, lighting, has_robot=has_robot)


def kept_at(x: float, y: float, scene: Scene, kept: Float32Array, T: FloatArray) -> float:
    """What is kept on the floor at a place."""
    p = np.linalg.inv(T) @ [x, y, 0, 1]
    row, column = (round(float(v)) for v in (130 * p[1] / p[2] + 59.5, 130 * p[0] / p[2] + 79.5))
    return float(kept[row, column])


def test_a_picture_is_dark_under_a_board_and_nowhere_else() -> None:
    scene, shadows = shadows_in('<geom name="board" type="box" pos="3 0 0.72" size="0.5 0.5 0.03"/>')
    T = looking(z=1.9, pitch=0.6)
    kept = shadows.kept(scene.cast(CAMERA, T), 1.0, None)
    # A pixel that sees the floor in the penumbra. The lamp is of power 1.2, the light from elsewhere worth 0.02.
    row, column, view = 66, 52, scene.cast(CAMERA, T)
    seen = T[:3, :3] @ (view.depth_m[row, column] * view.rays[row, column]) + T[:3, 3] - [3, 0, 0]
    away_m = LAMP_M - seen
    assert seen[2] == pytest.approx(0, abs=1e-5)
    light = 1.2 * 2.8 * 2.8 / ((0.3 + away_m @ away_m) ** 1.5 * np.sqrt(away_m @ away_m))
    hidden = by_rays(seen, np.array([0, 0, 0.69, 0.75, 1, 0, 0.5, 0.5]))
    assert 0.1 < hidden < 1.0
    assert kept[row, column] == pytest.approx(1 - 0.6 * hidden * light / (light + 0.02), abs=0.005)
    assert kept_at(1.8, 0.0, scene, kept, T) == 1.0
    assert kept_at(3.0, 1.3, scene, kept, T) == 1.0
    weak = shadows.kept(scene.cast(CAMERA, T), 0.25, None)
    # Each fourth column is found for itself; what lies between is interpolated where it differs little.
    np.testing.assert_allclose(1 - weak[:, ::4], 0.25 * (1 - kept[:, ::4]), atol=1e-6)


def test_an_empty_room_has_no_shadows_and_lamps_none_on_themselves() -> None:
    scene, shadows = shadows_in('<geom name="wall" type="box" pos="5 0 1.5" size="0.1 4 1.5"/>')
    for pitch in (0.4, -0.4):
        assert (shadows.kept(scene.cast(CAMERA, looking(pitch=pitch)), 1.0, None) == 1.0).all()


def test_a_swinging_leaf_takes_its_shadow_with_it() -> None:
    world = replace(
        room(FLOOR + LAMP + '<geom name="leaf" type="box" pos="2.4 0 0.6" size="0.02 0.5 0.6"/>', PAINTS),
        leaves=(Leaf("leaf", (2.4, 0.5), np.radians(90)),),
    )
    doors = Doors(world, away(), 1, seed=3)
    scene = Scene(world, threads=1, doors=doors)
    shadows, T = shadows_of(scene), looking(z=1.9, pitch=0.6)
    seen = {}
    for swing in doors.swings[0]:
        scene.move_to(swing.end_s)
        seen[swing.to_share] = kept_at(2.1, 0.0, scene, shadows.kept(scene.cast(CAMERA, T), 1.0, None), T)
    # On the near side of the shut leaf the lamp is hidden; turned away, it lets the light by.
    assert seen[0.0] < 0.7
    assert seen[1.0] == 1.0


def away() -> Drive:
    stamps_s = np.arange(0, 60, 0.01)
    T = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    T[:, 0, 3] = -9.0
    return Drive(Trajectory(stamps_s, T, body="base"), ())


def test_the_robots_shadow_goes_with_it() -> None:
    scene, shadows = shadows_in("", has_robot=True)
    T, view = looking(z=1.9, pitch=0.6), scene.cast(CAMERA, looking(z=1.9, pitch=0.6))
    for x, is_dark in ((2.6, True), (-3.0, False)):
        T_world_base = np.eye(4)
        T_world_base[0, 3] = x
        assert (kept_at(2.4, 0.0, scene, shadows.kept(view, 1.0, T_world_base), T) < 0.7) is is_dark


def test_a_wall_throws_no_shadow_but_hides_its_lamp_from_all_count() -> None:
    def share(geoms: str) -> float:
        scene, shadows = shadows_in(geoms)
        T = looking(x=-1.0, z=1.9, pitch=0.6)
        return kept_at(1.2, 0.0, scene, shadows.kept(scene.cast(CAMERA, T), 1.0, None), T)

    wall = '<geom name="wall" type="box" pos="2.2 0 1.4" size="0.1 4 1.4"/>'
    table = '<geom name="table" type="box" pos="1.6 0 0.7" size="0.2 0.4 0.05"/>'
    assert share(wall) == 1.0
    assert share(table) < 0.9
    assert share(wall + table) == 1.0
