"""Floor, body, mount, tyres and lights: closed forms, and spectra that come back as they were measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter, welch
from small_rooms import room

from wheelsight.core.areas import Area, AreaMap
from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import Realism, RobotModel, Surface, World, build_world, carriage_of
from wheelsight_sim.appearance import Lights, LightSettings, lighting_of
from wheelsight_sim.body_motion import (
    BodyMotion,
    BodySettings,
    FloorSettings,
    FloorSurface,
    LoadedRadii,
    MountSettings,
    TyreSettings,
    mounted,
    sprung,
)
from wheelsight_sim.scene import Scene
from wheelsight_sim.wheelchair import drag_n

QUIET = BodySettings(roll_rad_s=(0.0,) * 6, pitch_rad_s=(0.0,) * 6, yaw_rad_s=(0.0,) * 6)
CALM = BodySettings(pitch_rad_s2_m=0, roll_rad_s2_m=0)
SMOOTH = FloorSettings(threshold_m=(0.0, 0.0), carpet_m=0.0)
ROBOT = RobotModel()


def times(count: int) -> FloatArray:
    """(count,) seconds at 200 Hz."""
    return np.asarray(0.005 * np.arange(count), np.float64)


def ground(settings: FloorSettings = SMOOTH) -> FloorSurface:
    """20 m a side; areas meet at x = 2, and a carpet lies from (-2, 4) to (0, 6)."""
    surfaces = {"white": Surface("plain", (0.8, 0.8, 0.8)), "rug": Surface("carpet", (0.4, 0.2, 0.2))}
    geoms = '<geom name="rug" type="box" pos="-1 5 0.0015" size="1 1 0.0015" material="rug"/>'
    corners = ([(-9, -9), (2, -9), (2, 9), (-9, 9)], [(2, -9), (9, -9), (9, 9), (2, 9)])
    areas = [Area(f"a{k}", np.array(c, float), float(np.mean(c, axis=0)[0]), 0.0) for k, c in enumerate(corners)]
    world: World = replace(room(geoms, surfaces), areas=AreaMap(tuple(areas)), size_m=(-10.0, -10.0, 10.0, 10.0))
    return FloorSurface(world, settings, np.random.default_rng(0))


def drive(way_m: FloatArray, heading_rad: float | FloatArray = 0.0) -> Trajectory:
    """Along x by so much at 200 Hz, or turning on the spot."""
    stamps_s = times(len(way_m))
    T = np.broadcast_to(np.eye(4), (len(way_m), 4, 4)).copy()
    T[:, 0, 3] = way_m
    T[:, :3, :3] = so3.exp(np.asarray(heading_rad)[..., None] * np.array([0.0, 0, 1.0]))
    return Trajectory(stamps_s, T, body="base")


def angles_of(motion: BodyMotion, stamps_s: FloatArray) -> FloatArray:
    """(N, 3) roll, pitch and yaw."""
    return np.asarray(so3.log(motion.T_base_body(stamps_s)[:, :3, :3]))


def test_a_threshold_lies_between_areas_and_a_carpet_where_it_lies():
    floor = ground(FloorSettings(threshold_m=(0.008, 0.008), threshold_width_m=0.03, carpet_m=0.006))
    heights = floor.height_m([(2.0, 0.0), (2.06, 3.0), (5.0, 0.0), (-1.0, 5.0), (-3.0, 5.0)])
    np.testing.assert_allclose(heights, [0.008, 0.008 * np.exp(-2), 0, 0.006, 0], atol=1.5e-3)
    np.testing.assert_array_equal(floor.is_carpet([(-1.0, 5.0), (-0.1, 4.1), (0.1, 5.0), (2.0, 0.0)]), [1, 1, 0, 0])


def test_a_wheel_is_held_back_by_what_it_climbs_and_by_carpet():
    floor = ground(FloorSettings(threshold_m=(0.008, 0.008), threshold_width_m=0.04, carpet_m=0.0, carpet_drag=0.02))
    ahead, loads_n = np.array([1.0, 0.0]), np.array([400.0])
    slope = 0.008 / 0.04 * np.exp(-0.5)  # of the Gaussian, one half width before its top
    assert drag_n(floor, np.array([[1.96, 0.0]]), loads_n, ahead, 0.5) == pytest.approx(-400 * slope, rel=0.2)
    assert drag_n(floor, np.array([[2.04, 0.0]]), loads_n, ahead, 0.5) == pytest.approx(400 * slope, rel=0.2)
    assert drag_n(floor, np.array([[-1.0, 5.0]]), loads_n, ahead, 0.5) == pytest.approx(-8.0, rel=1e-3)
    assert drag_n(floor, np.array([[-1.0, 5.0]]), loads_n, ahead, 0.0) == 0
    assert drag_n(floor, np.array([[7.0, 0.0]]), loads_n, ahead, 0.5) == 0


def test_a_large_floor_has_larger_cells():
    wide = replace(build_world("square", 1), size_m=(0.0, 0.0, 300.0, 200.0))
    floor = FloorSurface(wide, FloorSettings(), np.random.default_rng(0))
    assert floor.height.size < 4.1e6
    assert floor.cell_m == pytest.approx(np.sqrt(302 * 202 / 4e6))


def test_a_body_at_even_speed_on_an_even_floor_stays_where_it_is():
    motion = BodyMotion(drive(0.5 * times(1000) - 6), ROBOT, ground(), QUIET, np.random.default_rng(0))
    np.testing.assert_allclose(
        motion.T_base_body(np.linspace(0.5, 4.5, 50)), np.broadcast_to(np.eye(4), (50, 4, 4)), atol=1e-7
    )


@pytest.mark.parametrize("period_s", [0.001, 0.02])
def test_a_mass_on_a_spring_moves_as_the_filter_of_the_bilinear_transform(period_s, rng):
    own, damped = QUIET.own_rad_s, 2 * QUIET.damping * QUIET.own_rad_s
    goal = 0.3 + np.cumsum(rng.normal(0, 1e-3, 5000))
    b, a = bilinear([damped, own**2], [1, damped, own**2], 1 / period_s)
    expected = lfilter(b, a, goal - goal[0]) + goal[0]
    np.testing.assert_allclose(sprung(goal, QUIET, period_s), expected, rtol=0, atol=1e-12)


def test_braking_dips_the_nose_by_the_springs_stiffness():
    t = times(1200)
    motion = BodyMotion(drive(4 * t - 0.25 * t**2 - 9), ROBOT, ground(), QUIET, np.random.default_rng(0))
    roll, pitch, yaw = angles_of(motion, t[600:1100]).T
    np.testing.assert_allclose(pitch, 0.5 * QUIET.pitch_rad_s2_m, rtol=0.02)  # about y, left: the nose goes down
    np.testing.assert_allclose([roll, yaw], 0, atol=1e-6)
    ahead = motion.T_base_body(t[700])[0, :3, :3] @ np.array([1.0, 0, 0])
    assert ahead[2] < 0


def test_a_bend_leans_the_body_out():
    t = times(1200)
    T = se3.exp(t[:, None] * np.array([0.8, 0, 0, 0, 0, 0.5]))
    motion = BodyMotion(Trajectory(t, T, body="base"), ROBOT, ground(), QUIET, np.random.default_rng(0))
    roll, pitch, _ = angles_of(motion, t[600:1100]).T
    np.testing.assert_allclose(roll, 0.4 * QUIET.roll_rad_s2_m, rtol=0.02)  # to the left: its left side rises
    np.testing.assert_allclose(pitch, 0, atol=1e-5)


def test_a_threshold_jolts_and_is_left_behind():
    t = times(2400)
    floor = ground(FloorSettings(threshold_m=(0.008, 0.008)))
    motion = BodyMotion(drive(0.5 * t), ROBOT, floor, QUIET, np.random.default_rng(0))
    pitch = angles_of(motion, t)[:, 1]
    # The castors, 0.45 m ahead, climb first: the nose goes up, and by less than stiff wheels would lift it.
    before, over = np.abs(pitch[t < 2.9]).max(), pitch[(t > 3.0) & (t < 3.4)].min()
    assert before < 1e-4
    assert -2 * 0.008 / 0.45 < over < -0.1 * 0.008 / 0.45
    assert np.abs(pitch[t > 8]).max() < 1e-4


def test_vibration_has_the_measured_spectrum():
    t = times(60_000)
    way_m = 1.1 * t - 1000
    motion = BodyMotion(drive(way_m), ROBOT, ground(), CALM, np.random.default_rng(1))
    angles = angles_of(motion, t)
    for axis, rates_rad_s in enumerate((CALM.roll_rad_s, CALM.pitch_rad_s, CALM.yaw_rad_s)):
        f_hz, density = welch(np.gradient(angles[:, axis], 0.005), 200, nperseg=2000)
        for low_hz, high_hz, rate_rad_s in list(zip(CALM.bands_hz, CALM.bands_hz[1:], rates_rad_s, strict=False))[:4]:
            inside = (f_hz >= low_hz) & (f_hz < high_hz)
            # Differences over 10 ms pass less of what is fast.
            passed = np.sinc(2 * f_hz[inside] * 0.005)
            got = np.sqrt((density[inside] / passed**2).sum() * f_hz[1])
            assert got == pytest.approx(rate_rad_s, rel=0.1)


def test_nothing_trembles_at_rest():
    motion = BodyMotion(drive(np.zeros(600)), ROBOT, ground(), CALM, np.random.default_rng(1))
    np.testing.assert_allclose(angles_of(motion, np.linspace(0, 2.9, 100)), 0, atol=1e-12)


def test_a_mount_is_off_as_far_as_said():
    T = ROBOT.T_base_camera
    np.testing.assert_allclose(mounted(T, MountSettings(0.0, 0.0), np.random.default_rng(0)), T, atol=1e-15)
    settings = MountSettings(sigma_m=0.004, sigma_deg=0.3)
    errors = [se3.log(se3.invert(T) @ mounted(T, settings, np.random.default_rng(k))) for k in range(500)]
    sigmas = np.std(errors, axis=0)
    np.testing.assert_allclose(sigmas[:3], 0.004, rtol=0.15)
    np.testing.assert_allclose(np.degrees(sigmas[3:]), 0.3, rtol=0.15)


def test_a_robot_carries_its_camera_where_mount_and_body_have_it():
    world = build_world("square", 3)
    truth = drive(0.5 * times(800) + 1.0)
    still = carriage_of(truth, world, ROBOT, None, 3)
    np.testing.assert_array_equal(still.T_base_camera, ROBOT.T_base_camera)
    np.testing.assert_allclose(still.T_world_camera(1.0)[0], truth.at(1.0)[0] @ ROBOT.T_base_camera)
    real = carriage_of(truth, world, ROBOT, Realism(), 3)
    assert real.body is not None
    expected = truth.at(1.0)[0] @ real.body.T_base_body(1.0)[0] @ real.T_base_camera
    np.testing.assert_allclose(real.T_world_camera(1.0)[0], expected, atol=1e-12)
    ends = real.T_world_camera([0.995, 1.005])
    np.testing.assert_allclose(
        real.moment(np.empty(0), 1.0).twist, se3.log(se3.invert(ends[0]) @ ends[1]) / 0.01, atol=1e-9
    )


def test_a_tyre_is_pressed_in_by_what_it_carries():
    settings = TyreSettings(stiffness_n_m=80_000, rolling_share=0.5, settling_s=0.1)
    radii = LoadedRadii(np.array([0.17, 0.17]), np.array([400.0, 400.0]), settings)
    np.testing.assert_allclose(radii.after(np.array([400.0, 400.0]), 0.005), 0.17)
    once = radii.after(np.array([560.0, 240.0]), 0.1)
    full_m = 0.5 * 160 / 80_000
    np.testing.assert_allclose(once, 0.17 + np.array([-1, 1]) * full_m * (1 - np.exp(-1)), atol=1e-12)
    np.testing.assert_allclose(radii.after(np.array([560.0, 240.0]), 10), 0.17 + np.array([-1, 1]) * full_m, atol=1e-9)


def test_lamps_are_switched_as_often_as_said():
    switched = [Lights(LightSettings(every_s=20.0), 100.0, np.random.default_rng(k)) for k in range(200)]
    levels = np.array([[lights.level_at(t) for t in np.arange(0, 100, 0.25)] for lights in switched])
    assert (np.diff(levels, axis=1) != 0).sum(axis=1).mean() == pytest.approx(5, rel=0.12)
    assert (levels[:, 0] > 0.99).mean() > 0.95
    assert levels.min() >= 0.35
    scene = Scene(build_world("square", 1), threads=1)
    looks = [scene.surfaces[material] for material in scene.geoms.materials]
    lighting = lighting_of(scene.geoms, looks, 1)
    lights = next(lights for lights in switched if lights.level_at(99.0) < 1)
    dim = lights.lit(lighting, 99.0)
    np.testing.assert_allclose(dim.tints[1], lights.level_at(99.0) * lighting.tints[1])
    np.testing.assert_array_equal(dim.tints[2], lighting.tints[2])
    np.testing.assert_array_equal(lights.lit(lighting, -1.0).tints, lighting.tints)
