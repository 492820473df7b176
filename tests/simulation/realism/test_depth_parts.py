"""Registration, distortion and sunlight of depth: what is known in closed form, and what is rendered otherwise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from small_rooms import looking, room, wall

from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight_sim.appearance import Sunlight, SunlightSettings
from wheelsight_sim.depth_sensor import (
    DisparityDistortion,
    DisparityDistortionSettings,
    PhaseDistortion,
    PhaseDistortionSettings,
    Registration,
    RegistrationSettings,
    multipath_m,
)
from wheelsight_sim.scene import Scene, View

CAMERA = PinholeCamera(160, 120, 146, 146, 79.5, 59.5)
STILL = np.zeros(6)
CLUTTER = (
    '<geom name="back" type="box" pos="5 0 1" size="1 30 30"/>'
    '<geom name="post" type="box" pos="2.2 0.3 1" size="0.1 0.25 5"/>'
    '<geom name="low" type="box" pos="1.6 -0.5 0.5" size="0.1 0.3 0.3"/>'
)
NO_HOLES: dict[str, Any] = {"border_px": (0.0, 0.0, 0.0, 0.0), "step_px": 1e9}
EXACT: dict[str, Any] = {"offset_sigma_px": 0, "scale_sigma": 0, "parallax_sigma_px_m": 0}


def registration(seed: int = 0, **changed: Any) -> Registration:
    return Registration(RegistrationSettings(**(NO_HOLES | EXACT | changed)), CAMERA.width, np.random.default_rng(seed))


def test_depth_is_taken_up_to_half_a_period_from_colour():
    times_s = np.arange(0, 60, 0.1)
    late_s = np.array([registration().late_s(t) for t in times_s])
    assert np.abs(late_s).max() <= 1 / 60
    assert late_s.min() < -0.015
    assert late_s.max() > 0.015
    steps = np.diff(late_s)
    assert np.median(np.abs(steps)) == pytest.approx(0.1 * RegistrationSettings().drift)


def test_depth_lies_beside_colour_by_its_offset():
    unit = registration()
    unit.offset_px = np.array([3.0, -2.0])
    view = Scene(room(CLUTTER), threads=1).cast(CAMERA, looking())
    seen = unit.seen_by_depth(view, STILL, 0.0)
    np.testing.assert_array_equal(seen.depth_m[2:, :-3], view.depth_m[:-2, 3:])
    np.testing.assert_array_equal(seen.geom[2:, :-3], view.geom[:-2, 3:])
    assert not seen.depth_m[:2].any()
    assert not seen.depth_m[:, -3:].any()
    assert (seen.geom[seen.depth_m == 0] == -1).all()


def test_depth_is_larger_by_its_scale():
    unit = registration()
    unit.scale = 0.05
    view = Scene(room(CLUTTER), threads=1).cast(CAMERA, looking())
    seen = unit.seen_by_depth(view, STILL, 0.0)
    for column in (20, 50, 80, 110, 140):
        source = round(column + 0.05 * (column - 80))
        np.testing.assert_array_equal(seen.depth_m[60, column], view.depth_m[60, source])


def test_near_things_are_further_off():
    unit = registration()
    unit.parallax_px_m = np.array([6.0, 0.0])
    scene = Scene(room(CLUTTER), threads=1)
    view = scene.cast(CAMERA, looking())
    seen = unit.seen_by_depth(view, STILL, 0.0)
    row = 60
    post, shifted = (np.flatnonzero(v.geom[row] == 1) for v in (view, seen))
    # 6 px m over 2.1 m; on the side where the wall behind is asked, over 4 m.
    assert post[0] - shifted[0] in (1, 2)
    assert post[-1] - shifted[-1] == 3


@pytest.mark.parametrize(
    "twist", [(0.0, 0, 0, 0, 1.0, 0), (0, 0, 0, 0.8, 0, 0), (0, 0, 1.0, 0, 0, 0), (0.5, 0, 0.5, 0, 0.4, 0.6)]
)
def test_depth_shows_the_moment_at_which_it_is_taken(twist):
    unit = registration()
    stamp_s = max(np.arange(0, 20, 0.5), key=lambda t: unit.late_s(t))
    late_s = unit.late_s(stamp_s)
    assert late_s > 0.01
    scene = Scene(room(CLUTTER), threads=1)
    view = scene.cast(CAMERA, looking())
    later = scene.cast(CAMERA, looking() @ se3.exp(late_s * np.array(twist)))
    seen = unit.seen_by_depth(view, np.array(twist), stamp_s)

    def off(depth_m):
        both = (depth_m > 0) & (later.depth_m > 0)
        return np.abs(depth_m - later.depth_m)[both]

    assert np.mean(off(seen.depth_m) > 0.005) < 0.03
    assert np.median(off(seen.depth_m)) < 1e-3
    assert off(seen.depth_m).mean() < 0.6 * off(view.depth_m).mean()


def test_edges_have_holes_and_slopes_have_none():
    settings = RegistrationSettings(**EXACT, border_px=(8, 16, 12, 4))
    unit = Registration(settings, CAMERA.width, np.random.default_rng(0))
    floor = '<geom name="floor" type="plane" size="40 40 1"/>'
    scene = Scene(room(floor + CLUTTER), threads=1)
    view = scene.cast(CAMERA, looking(pitch=0.3))
    seen = unit.seen_by_depth(view, STILL, 0.0)
    inner = np.s_[4:-1, 2:-3]  # a quarter of the pixels' numbers: the image is a quarter as wide
    assert not seen.depth_m[:4].any()
    assert not seen.depth_m[:, -3:].any()
    lost = (seen.depth_m == 0)[inner] & (view.depth_m > 0)[inner]
    edge = np.abs(np.diff(view.depth_m, axis=1, prepend=0)) > 0.5
    assert lost[edge[inner]].mean() > 0.9
    plain = Scene(room(floor), threads=1).cast(CAMERA, looking(pitch=0.5))
    assert (unit.seen_by_depth(plain, STILL, 0.0).depth_m[inner] > 0).all()


def exact(**changed: Any) -> DisparityDistortionSettings:
    return DisparityDistortionSettings(**({"rough_sigma_steps": 0, "unlike_sigma": 0, "scale_sigma": 0} | changed))


@pytest.mark.parametrize(("distance_m", "steps"), [(0.9, -3.1 - 0.3), (4.0, -0.3 - 3.1 * np.exp(-6.2))])
def test_disparities_are_off_in_the_middle_as_measured(distance_m, steps):
    view = Scene(room(wall(distance_m)), threads=1).cast(CAMERA, looking())
    settings = exact()
    depth_m = DisparityDistortion(settings, CAMERA, np.random.default_rng(0)).distorted(view)
    middle = depth_m[59:61, 79:81].mean()
    focal_baseline = settings.native_focal_px * settings.baseline_m
    assert 8 * (focal_baseline / distance_m - focal_baseline / middle) == pytest.approx(steps, abs=0.01)


def test_units_differ_and_scale_depth():
    view = Scene(room(wall(2.0)), threads=1).cast(CAMERA, looking())
    flat = exact(near_steps=(0,) * 7, far_steps=(0,) * 7, scale_sigma=0.01)
    ratios = []
    for seed in range(200):
        depth_m = DisparityDistortion(flat, CAMERA, np.random.default_rng(seed)).distorted(view)
        ratios.append(depth_m.mean() / 2.0 - 1)
        assert np.ptp(depth_m) < 1e-3
    assert np.std(ratios) == pytest.approx(0.01, rel=0.15)


def test_light_takes_no_detour_before_a_wall_and_one_in_a_corner():
    flat = Scene(room(wall(2.0)), threads=1).cast(CAMERA, looking())
    np.testing.assert_allclose(multipath_m(flat, np.full(1, 0.7), (24, 20)), 0, atol=1e-6)
    narrow_m, wide_m = (multipath_m(corner(degrees), np.full(2, 0.7), (24, 20)) for degrees in (45, 75))
    middle = np.s_[40:80, 70:90]
    assert 0.005 < narrow_m[middle].mean() < 0.2
    assert 0 < wide_m[middle].mean() < 0.3 * narrow_m[middle].mean()
    np.testing.assert_allclose(narrow_m[60], narrow_m[60, ::-1], atol=5e-3)
    np.testing.assert_array_equal(multipath_m(corner(45), np.zeros(2), (24, 20)), 0)


def corner(degrees: float) -> View:
    """Two walls that meet 3 m ahead, each turned so far out of the way ahead."""
    walls = [
        f'<geom name="{name}" type="box" pos="3 0 1" size="0.01 9 9" euler="0 0 {sign * (90 - degrees)}"/>'
        for name, sign in (("left", 1), ("right", -1))
    ]
    return Scene(room("".join(walls)), threads=1).cast(CAMERA, looking())


def test_distances_swing_about_the_true_ones():
    settings = PhaseDistortionSettings(offset_sigma_m=0, radial_m=0)
    unit = PhaseDistortion(settings, CAMERA, np.full(1, 0.6), np.random.default_rng(3))
    off_m = []
    for distance_m in np.arange(1.0, 1.0 + settings.wave_m, settings.wave_m / 16):
        view = Scene(room(wall(distance_m)), threads=1).cast(CAMERA, looking())
        off_m.append(float((unit.distorted(view) - view.depth_m).mean()))
    assert np.mean(off_m) == pytest.approx(0, abs=1e-4)
    assert np.sqrt(2) * np.std(off_m) == pytest.approx(settings.swing_m, rel=0.02)


def sunny(chance: float = 1.0, more: str = "") -> tuple[Scene, Sunlight]:
    """A floor, what there is more, and a window 1 m high and 2 m wide, 3 m ahead, before the sun at 45°."""
    geoms = (
        '<geom name="floor" type="plane" size="40 40 1"/>'
        '<geom name="pane_east" type="box" pos="3 0 2" size="0.015 1 0.5"/>' + more
    )
    scene = Scene(room(geoms), threads=1)
    settings = SunlightSettings(chance=chance, elevation_deg=(45.0, 45.0))
    return scene, Sunlight(settings, scene, np.array([1.0, 0, 0]), np.random.default_rng(0))


def test_the_sun_shines_on_the_floor_where_the_window_lets_it():
    scene, sun = sunny()
    view = scene.cast(CAMERA, looking(x=-1.0, pitch=0.4))
    share = sun.on(view)
    p = view.T_world_camera[0, :3, 3] + (view.rays * view.depth_m[..., None]) @ view.T_world_camera[0, :3, :3].T
    x, y = p[..., 0], p[..., 1]
    on_floor = view.geom == 0
    # From a point at x the sun's ray is 3 - x high at the window.
    inside = on_floor & (x > 0.51) & (x < 1.49) & (np.abs(y) < 0.99)
    outside = on_floor & ((x < 0.49) | (x > 1.51) | (np.abs(y) > 1.01))
    assert inside.sum() > 100
    np.testing.assert_allclose(share[inside], np.sqrt(0.5), rtol=1e-6)
    np.testing.assert_array_equal(share[outside], 0)


def test_what_stands_in_the_sun_throws_a_shadow():
    board = '<geom name="board" type="box" pos="2 -0.5 1" size="0.02 0.5 2"/>'
    _, whole = sunny()
    scene, sun = sunny(more=board)
    view = scene.cast(CAMERA, looking(x=-1.0, pitch=0.4))
    share, without = sun.on(view), whole.on(view)
    p = view.T_world_camera[0, :3, 3] + (view.rays * view.depth_m[..., None]) @ view.T_world_camera[0, :3, :3].T
    behind = (view.geom == 0) & (without > 0) & (p[..., 1] < -0.05) & (p[..., 1] > -0.95)
    beside = (view.geom == 0) & (without > 0) & (p[..., 1] > 0.05)
    assert min(behind.sum(), beside.sum()) > 50
    assert not share[behind].any()
    np.testing.assert_array_equal(share[beside], without[beside])


def test_some_days_are_overcast():
    scene, sun = sunny(chance=0.0)
    assert not sun.on(scene.cast(CAMERA, looking(x=-1.0, pitch=0.4))).any()
