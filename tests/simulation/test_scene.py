from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from odometry.plain_kernels import plain
from small_rooms import looking, room

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import FloatArray, PinholeCamera, se3
from wheelsight_sim import view_kernels as kernels
from wheelsight_sim.scene import Scene, View

CAMERA = PinholeCamera(80, 60, 70, 70, 39.5, 29.5)
NAMES = ("floor", "box", "ball", "ceiling")
ROOM = room(
    '<geom name="floor" type="plane" size="20 20 1"/>'
    '<geom name="box" type="box" pos="3 0.5 0.6" size="0.4 0.3 0.6" euler="0 0 30"/>'
    '<geom name="ball" type="sphere" pos="2.5 -0.6 1.1" size="0.35"/>'
    '<geom name="ceiling" type="box" pos="0 0 2.9" size="15 15 0.1"/>'
)


def floor_depth(origin: FloatArray, ray: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        t = -origin[..., 2] / ray[..., 2]
        on_floor = np.abs(origin + t[..., None] * ray)[..., :2].max(axis=-1) <= 20
    return np.where((t > 0) & on_floor, t, np.inf)


def box_depth(origin: FloatArray, ray: FloatArray, center: FloatArray, half: FloatArray, yaw: float) -> FloatArray:
    """The slab method, in the box's frame."""
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    o, d = (origin - center) @ R, ray @ R
    with np.errstate(divide="ignore"):
        first, second = (-half - o) / d, (half - o) / d
    enters, leaves = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    return np.where((enters <= leaves) & (enters > 0), enters, np.inf)


def ball_depth(origin: FloatArray, ray: FloatArray, center: FloatArray, radius: float) -> FloatArray:
    o = origin - center
    a, b, c = (ray**2).sum(-1), (o * ray).sum(-1), (o**2).sum(-1) - radius**2
    with np.errstate(invalid="ignore"):
        t = (-b - np.sqrt(b**2 - a * c)) / a
    return np.where(np.isfinite(t) & (t > 0), t, np.inf)


def closed_form(camera: PinholeCamera, T_rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Depth (H, W), 0 for none, and which of NAMES is hit, by the geometry of ROOM alone."""
    rays = np.einsum("rij,rcj->rci", T_rows[:, :3, :3], camera.rays())
    origins = np.broadcast_to(T_rows[:, None, :3, 3], rays.shape)
    all_m = np.stack(
        [
            floor_depth(origins, rays),
            box_depth(origins, rays, np.array([3, 0.5, 0.6]), np.array([0.4, 0.3, 0.6]), np.radians(30)),
            ball_depth(origins, rays, np.array([2.5, -0.6, 1.1]), 0.35),
            box_depth(origins, rays, np.array([0, 0, 2.9]), np.array([15, 15, 0.1]), 0.0),
        ]
    )
    nearest = all_m.min(axis=0)
    return np.where(np.isfinite(nearest), nearest, 0), np.where(np.isfinite(nearest), all_m.argmin(axis=0), -1)


def rows_of(T: FloatArray, camera: PinholeCamera = CAMERA) -> FloatArray:
    return np.broadcast_to(T, (camera.height, 4, 4))


@pytest.mark.parametrize(
    "T",
    [
        looking(),
        looking(0.5, -1, 1.5, 0.4, 0.3),
        looking(2.9, -2.5, 0.7, 1.5, -0.2),
        looking(3, 0.5, 1.9, 0, 1.5),
        looking(1, 0, 1.2, -2, -1.2),
    ],
)
def test_rays_meet_planes_boxes_and_balls_where_geometry_says(T: FloatArray) -> None:
    view = Scene(ROOM).cast(CAMERA, T)
    depth_m, hit = closed_form(CAMERA, rows_of(T))
    np.testing.assert_array_equal(view.geom, hit)
    np.testing.assert_allclose(view.depth_m, depth_m, rtol=1e-6)


def test_normals_point_outward_and_have_unit_length() -> None:
    T = looking(0.5, -1, 1.5, 0.4, 0.3)
    view = Scene(ROOM).cast(CAMERA, T)
    points = np.einsum("ij,rcj->rci", T[:3, :3], view.rays * view.depth_m[..., None]) + T[:3, 3]
    expected = np.zeros_like(view.normal_world)
    expected[view.geom == 0], expected[view.geom == 3] = (0, 0, 1), (0, 0, -1)
    expected[view.geom == 2] = (points[view.geom == 2] - (2.5, -0.6, 1.1)) / 0.35
    known = np.isin(view.geom, (-1, 0, 2, 3))
    np.testing.assert_allclose(view.normal_world[known], expected[known], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(view.normal_world[view.geom >= 0], axis=-1), 1, atol=1e-6)
    assert {0, 1, 2, 3} <= set(view.geom.ravel())


def test_rays_follow_the_lens() -> None:
    bent = replace(CAMERA, distortion=(0.2, -0.3, 0.002, -0.001, 0.1))
    view = Scene(ROOM).cast(bent, looking())
    depth_m, hit = closed_form(bent, rows_of(looking(), bent))
    np.testing.assert_array_equal(view.geom, hit)
    np.testing.assert_allclose(view.depth_m, depth_m, rtol=1e-6)


def test_rows_of_a_rolling_shutter_see_from_where_they_are() -> None:
    camera = PinholeCamera(160, 120, 140, 140, 79.5, 59.5)
    # Twice the chair's top speed in a quick turn: 1.2 m/s, 2 rad/s through a shutter of 52 ms.
    twist = np.array([0.0, 0.0, 1.2, 0.1, 2.0, 0.0]) * 0.052
    T_rows = looking(0.3, 0.0, 1.2, 0.2, 0.1) @ se3.exp(np.linspace(-0.5, 0.5, 120)[:, None] * twist)
    view = Scene(ROOM).cast(camera, T_rows)
    depth_m, hit = closed_form(camera, T_rows)
    same = view.geom == hit
    assert same.mean() > 0.999
    flat = same & (hit != 2) & (hit >= 0)
    normal_camera = np.einsum("rij,rci->rcj", T_rows[:, :3, :3], view.normal_world)
    grazing = np.abs((normal_camera * view.rays).sum(-1)) < 0.03 * np.linalg.norm(view.rays, axis=-1)
    # Faces of one box pass at its corners, where a plane does not go on.
    error = np.abs(view.depth_m - depth_m) / np.maximum(depth_m, 1)
    assert np.quantile(error[flat & ~grazing], 0.999) < 2e-6
    assert error[same & (hit == 2)].max() < 5e-3, "at the outline, where the ball is seen edge on"
    assert np.median(error[same & (hit == 2)]) < 1e-5
    still, _ = closed_form(camera, rows_of(T_rows[60], camera))
    assert np.median(np.abs(still - depth_m)[flat]) > 5e-3, "or the test would not tell rows from a frame"


def cluttered(rng: np.random.Generator, count: int = 250) -> str:
    kinds = ("box", "cylinder", "capsule", "sphere", "ellipsoid")
    geoms = ['<geom name="floor" type="plane" size="20 20 1"/>']
    for i in range(count):
        x, y, z = rng.uniform((-9, -9, 0), (9, 9, 3))
        size = " ".join(f"{s:.3f}" for s in rng.uniform(0.05, 0.6, 3))
        turn = " ".join(f"{s:.1f}" for s in rng.uniform(-180, 180, 3))
        geoms.append(
            f'<geom name="g{i}" type="{kinds[i % 5]}" pos="{x:.3f} {y:.3f} {z:.3f}" size="{size}" euler="{turn}"/>'
        )
    geoms.append('<geom name="long" type="box" pos="0 4 1.4" size="12 0.1 1.4"/>')
    return "".join(geoms)


def test_no_geom_is_missed_among_hundreds(rng: np.random.Generator) -> None:
    scene = Scene(room(cluttered(rng)))
    camera = PinholeCamera(48, 36, 40, 40, 23.5, 17.5)
    for _ in range(6):
        x, y, z = rng.uniform((-6, -6, 0.5), (6, 3, 2))
        T = looking(x, y, z, rng.uniform(-3, 3), rng.uniform(-1.5, 1.5))
        view = scene.cast(camera, T)
        rays, origin, geom = camera.rays() @ T[:3, :3].T, np.ascontiguousarray(T[:3, 3]), np.zeros(1, np.int32)
        for row, column in np.ndindex(36, 48):
            ray, normal = np.ascontiguousarray(rays[row, column]), np.zeros(3)
            far = mujoco.mj_ray(scene.model, scene.data, origin, ray, None, True, -1, geom, normal)
            assert view.geom[row, column] == geom[0]
            assert view.depth_m[row, column] == pytest.approx(max(far, 0), rel=1e-6)
            np.testing.assert_allclose(view.normal_world[row, column], normal if far >= 0 else 0, atol=1e-6)


def test_threads_do_not_change_a_bit(rng: np.random.Generator) -> None:
    world = room(cluttered(rng))
    T_rows = looking(z=1.3) @ se3.exp(np.linspace(-0.5, 0.5, 60)[:, None] * [0, 0, 0.03, 0, 0.05, 0])
    one, two, five = (Scene(world, threads=n).cast(CAMERA, T_rows) for n in (1, 2, 5))
    for name in ("depth_m", "geom", "normal_world"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
        np.testing.assert_array_equal(getattr(one, name), getattr(five, name))


def test_one_pose_and_one_a_row_need_the_same_kernels() -> None:
    """Numba compiles a kernel once more for poses that may not be written, which takes seconds."""
    T_rows = np.ascontiguousarray(rows_of(looking()))
    given = (looking(), T_rows, np.broadcast_to(T_rows, T_rows.shape))
    flags = [Scene(ROOM).cast(CAMERA, T).T_world_camera.flags for T in given]
    assert all(flag.writeable and flag.c_contiguous for flag in flags)


def test_fully_transparent_geoms_are_not_seen() -> None:
    world = room('<geom name="pane" type="box" pos="2 0 1" size="0.1 2 2"/>')
    glass = replace(world, mjcf=world.mjcf.replace("0.5 0.5 0.5 1", "0.5 0.5 0.5 0"))
    assert (Scene(world).cast(CAMERA, looking()).geom == 0).any()
    assert (Scene(glass).cast(CAMERA, looking()).geom == -1).all()


def test_geoms_are_those_of_the_mjcf() -> None:
    geoms = Scene(ROOM).geoms
    assert geoms.names == NAMES
    assert geoms.materials == ("white",) * 4
    assert geoms.kind.tolist() == [0, 6, 2, 6]
    np.testing.assert_allclose(geoms.size_m[1], (0.4, 0.3, 0.6))
    np.testing.assert_allclose(geoms.position_world[2], (2.5, -0.6, 1.1))
    np.testing.assert_allclose(geoms.R_world_geom[1][:2, 0], (np.cos(np.pi / 6), np.sin(np.pi / 6)))


def test_a_small_image_has_a_band_a_row() -> None:
    camera = PinholeCamera(4, 3, 3, 3, 1.5, 1)
    view: View = Scene(ROOM).cast(camera, looking())
    depth_m, _ = closed_form(camera, rows_of(looking(), camera))
    np.testing.assert_allclose(view.depth_m, depth_m, rtol=1e-6)


@pytest.mark.parametrize(
    ("geoms", "problem"),
    [
        ('<geom type="sphere" size="1"/>', "has no name"),
        ('<geom name="a" type="sphere" size="-1"/>', "MuJoCo does not take its MJCF"),
        ('<geom name="a" type="sphere" size="1" material="gold"/>', "MuJoCo does not take its MJCF"),
    ],
)
def test_worlds_that_cannot_be_seen_are_refused(geoms: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem) as caught:
        Scene(room(geoms))
    assert "\n" not in str(caught.value)


def test_geoms_without_material_or_surface_are_refused() -> None:
    with pytest.raises(ConfigError, match="geom floor has no material"):
        Scene(replace(ROOM, mjcf=ROOM.mjcf.replace('<geom material="white"/>', "")))
    with pytest.raises(ConfigError, match="material white has no surface"):
        Scene(replace(ROOM, surfaces={}))


def test_meshes_are_refused() -> None:
    mesh = '<mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
    world = room('<geom name="odd" type="mesh" mesh="m"/>')
    with pytest.raises(ConfigError, match="geom odd is no primitive"):
        Scene(replace(world, mjcf=world.mjcf.replace("<asset>", f"<asset>{mesh}")))


def chosen_by(scene: Scene, bounds: tuple[float, float, float, float]) -> list[str]:
    """Names of the geoms that rays of `looking()` within bounds on the plane z = 1 are cast at."""
    g, half = scene.geoms, np.array(scene.model.geom_aabb[:, 3:])
    T = looking()
    R, origin = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    boxes = kernels.Boxes(g.kind, g.size_m, g.position_world, half, g.R_world_geom)
    arguments = (boxes, np.arange(len(half), dtype=np.int32), R, origin, np.array(bounds))
    chosen = kernels.choose(*arguments)
    np.testing.assert_array_equal(chosen, plain(kernels).choose(*arguments))
    return [g.names[index] for index in chosen]


def test_rays_are_cast_only_at_what_they_can_hit() -> None:
    scene = Scene(
        room(
            '<geom name="floor" type="plane" size="20 20 1"/>'
            '<geom name="wall" type="box" pos="4 0 1" size="0.1 2 2"/>'
            '<geom name="picture" type="box" pos="3.89 0 1" size="0.01 0.5 0.5"/>'
            '<geom name="hidden" type="box" pos="6 0 1" size="0.5 0.5 0.5"/>'
            '<geom name="aside" type="sphere" pos="6 4 1" size="0.5"/>'
            '<geom name="behind" type="sphere" pos="-3 0 1" size="0.5"/>'
            '<geom name="cellar" type="sphere" pos="4 0 -3" size="0.5"/>'
            '<geom name="around" type="box" pos="0 0 1" size="15 15 9"/>',
        )
    )
    # Right up to the wall's corners nothing behind it counts; beyond them it does not fill the view.
    assert chosen_by(scene, (-0.5, 0.5, -0.4, 0.2)) == ["floor", "wall", "picture", "around"]
    assert chosen_by(scene, (-0.75, 0.5, -0.1, 0.1)) == ["floor", "wall", "picture", "hidden", "aside", "around"]
    assert chosen_by(scene, (-0.5, 0.5, 0.6, 0.8)) == ["floor", "around"]
    everything = chosen_by(scene, (-np.inf, np.inf, -np.inf, np.inf))
    assert everything == list(scene.geoms.names)


def test_aiming_turns_each_row_by_its_own_pose() -> None:
    rays = np.ascontiguousarray(CAMERA.rays())
    T_rows = looking(pitch=0.2) @ se3.exp(np.linspace(-1, 1, 60)[:, None] * [0, 0, 0, 0.02, 0.1, 0])
    tile, R = np.array([8, 20, 10, 31]), np.ascontiguousarray(T_rows[14, :3, :3])
    for module in (kernels, plain(kernels)):
        out = np.empty((12 * 21, 3))
        bounds = module.aim(rays, T_rows, tile, R, out)
        expected = np.einsum("rij,rcj->rci", T_rows[8:20, :3, :3], rays[8:20, 10:31])
        np.testing.assert_allclose(out.reshape(12, 21, 3), expected, atol=1e-14)
        in_tile = expected @ R
        u, v = in_tile[..., 0] / in_tile[..., 2], in_tile[..., 1] / in_tile[..., 2]
        np.testing.assert_allclose(bounds, (u.min(), u.max(), v.min(), v.max()), atol=1e-14)
        turned = module.aim(rays, T_rows, tile, -R, out)
        assert np.isinf(turned).all()
