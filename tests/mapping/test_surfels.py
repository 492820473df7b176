"""Fusion: what averaging gains, and which surfels come, stay and go."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from mapping.scenes import FRAME_S, GRID, NOISE, SHAPE, Wall, fuse, look_at, made_map, pose, rays, see
from scipy.spatial import KDTree

from wheelsight.core.errors import MapError
from wheelsight.core.keyframes import FrameSurface
from wheelsight.mapping import SurfelMap, Surfels

FRAMES = 20
FIELDS = ("position", "normal", "radius_m", "color", "grey", "confidence", "variance_m2", "first_s", "last_s")


def swaying(frames: int) -> list[np.ndarray]:
    """Poses of a camera that sways by 10 cm and turns by 5 degrees before the wall."""
    phase = np.linspace(0, 2 * np.pi, frames)
    return [pose(0.1 * np.sin(p), 0.05 * np.cos(p), 0.05 * np.sin(2 * p), 0.09 * np.sin(p)) for p in phase]


@pytest.mark.parametrize("wall", [Wall(2.0), Wall(2.0, slope=0.8), Wall(3.5, slope=-0.3)])
def test_averaging_a_still_view_is_worth_the_root_of_the_number_of_frames(wall, rng):
    surfel_map = made_map()
    look_at(surfel_map, [wall], [pose()] * FRAMES, rng)
    surfels = surfel_map.surfels("stable")
    assert len(surfels.grey) > 0.5 * SHAPE[0] * SHAPE[1]
    u, v = (f * surfels.position[:, k] / surfels.position[:, 2] for k, f in enumerate(GRID[:2]))
    # Readings beside the image's centre weigh less.
    inner = np.hypot(u, v) < 0.2 * GRID[2]
    error = wall.distance(surfels.position)[inner]
    # Of a plane whose every depth errs by σ(z) along its ray.
    expected = NOISE.sigma_m(surfels.position[inner, 2]) * abs(wall.normal[2]) / np.sqrt(FRAMES)
    rays_there = surfels.position[inner] / surfels.position[inner, 2:]
    expected = expected * np.abs(rays_there @ wall.normal) / abs(wall.normal[2])
    assert np.sqrt(np.mean((error / expected) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(error**2 / surfels.variance_m2[inner])) == pytest.approx(1.0, abs=0.15)
    assert np.median(surfels.normal @ wall.normal) > 0.9999


def test_a_moving_camera_averages_into_the_same_surfels(rng):
    surfel_map, wall = made_map(), Wall(2.0, slope=0.3)
    look_at(surfel_map, [wall], swaying(60), rng)
    surfels = surfel_map.surfels("stable")
    assert np.sqrt(np.mean(wall.distance(surfels.position) ** 2)) < 0.5 * NOISE.sigma_m(2.0)
    assert len(surfel_map) < 3 * SHAPE[0] * SHAPE[1]


def test_confidence_counts_frames_and_readings_weigh_by_how_central_they_are():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * 5)
    surfels = surfel_map.surfels()
    u = GRID[0] * surfels.position[:, 0] / surfels.position[:, 2]
    v = GRID[1] * surfels.position[:, 1] / surfels.position[:, 2]
    farthest2 = max(GRID[2], SHAPE[1] - 1 - GRID[2]) ** 2 + max(GRID[3], SHAPE[0] - 1 - GRID[3]) ** 2
    weight = np.exp(-(u**2 + v**2) / farthest2 / (2 * 0.6**2))
    np.testing.assert_array_equal(surfels.confidence, 5)
    one_m2 = NOISE.sigma_m(2.0) ** 2
    np.testing.assert_allclose(surfels.variance_m2, one_m2 / (5 * weight), rtol=1e-3)
    assert len(surfels.grey) == SHAPE[0] * SHAPE[1]


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_a_surfel_is_as_large_as_its_pixel_on_the_surface(slope):
    surfel_map, wall = made_map(), Wall(1.5, slope=slope)
    look_at(surfel_map, [wall], [pose()])
    surfels = surfel_map.surfels()
    towards = -surfels.position / np.linalg.norm(surfels.position, axis=1, keepdims=True)
    cosine = np.maximum(towards @ wall.normal, 0.35)
    np.testing.assert_allclose(surfels.radius_m, surfels.position[:, 2] / GRID[0] / cosine, rtol=1e-4)


def test_from_nearer_surfels_become_finer_and_more():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * 10)
    before = surfel_map.surfels()
    look_at(surfel_map, [Wall(2.0)], [pose(z=1.0)] * 30, start_s=1.0)
    after = surfel_map.surfels()
    middle, middle_before = (np.abs(s.position[:, :2]).max(axis=1) < 0.3 for s in (after, before))
    assert np.count_nonzero(middle) > 1.3 * np.count_nonzero(middle_before)
    assert np.median(after.radius_m[middle]) < 0.75 * np.median(before.radius_m)


def test_laps_of_the_same_place_do_not_fill_it_for_ever(monkeypatch):
    """Nor do they leave it open: what is seen stays within the gap of a surfel."""
    wall = Wall(1.2, slope=2.5)

    def laps() -> tuple[float, float]:
        rng, surfel_map, count = np.random.default_rng(0), made_map(), []
        for lap in range(5):
            way = [pose(*rng.uniform(-0.05, 0.05, 3)) @ step for step in swaying(40)]
            look_at(surfel_map, [wall], way, rng, start_s=10.0 * lap)
            count.append(len(surfel_map.surfels("stable").grey))
        depth_m = see([wall], pose()).depth_m
        seen = (depth_m[..., None] * rays())[depth_m > 0]
        off_m, _ = KDTree(surfel_map.surfels("stable").position).query(seen)
        return count[-1] / count[-3], float(np.mean(off_m > 0.02))

    growth_settled, far_settled = laps()
    usual = SurfelMap._rules_for  # noqa: SLF001
    without_gap = {"gap_m": np.float32(0.0)}
    monkeypatch.setattr(SurfelMap, "_rules_for", lambda *of: usual(*of)._replace(**without_gap))
    growth, far = laps()
    assert growth > 1.03
    assert growth_settled < 1.01
    assert far_settled < far + 0.005  # by chance one or the other has more


def test_a_wall_that_comes_into_reach_is_shown_where_it_is():
    """A Kinect's depth has steps: of a wall at the limit only pixels a step too near are within it."""
    surfel_map, wall, off_m = made_map(), Wall(7.0), []
    for k in range(40):
        T = pose(z=0.6 + 0.02 * k)
        view = see([wall], T)
        # Neighbouring readings lie a step to either side; the step is that of 1/z.
        disparity = 0.0029 * np.rint(1 / view.depth_m / 0.0029 + np.tile([-0.5, 0.0, 0.5, 0.0], SHAPE[1] // 4))
        quantised = replace(view, depth_m=(1 / disparity).astype(np.float32))
        fuse(surfel_map, quantised, T, k * FRAME_S)
        shown = surfel_map.predict(T, GRID, SHAPE).depth_m
        if np.count_nonzero(shown) > 0.25 * shown.size:
            off_m.append(float(np.mean((shown - view.depth_m)[shown > 0])))
    assert len(off_m) > 5
    assert np.abs(off_m[0]) < 0.08  # a step of the depth is 0.1 m there
    assert np.abs(off_m[4:]).max() < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_wall_that_comes_nearer_is_not_shown_too_near(seed):
    """Not by those readings that lay it, nor by weights that favour near ones, nor by showing the nearest of disks."""
    rng, surfel_map, wall, off_m = np.random.default_rng(seed), SurfelMap(), Wall(8.0), []
    noise = replace(NOISE, far_m=10.0)
    for k in range(45):
        T = pose(z=0.08 * k)
        if 4.6 < wall.depth_m - T[2, 3] < 5.6:
            shown = surfel_map.predict(T, GRID, SHAPE).depth_m
            assert np.count_nonzero(shown) > 0.95 * shown.size
            off_m.append(np.mean(shown[shown > 0]) - (wall.depth_m - T[2, 3]))
        view = see([wall], T, rng)
        surfel_map.fuse(view, GRID, T, 0.1 * k, noise)
    assert len(off_m) == 12
    assert abs(np.mean(off_m)) < 2.5e-3  # one reading errs by 38 mm


def test_color_and_grey_are_means_of_what_was_seen():
    surfel_map, view = made_map(), see([Wall(2.0)], pose())
    for k, level in enumerate((100.0, 110.0, 120.0)):
        dull = replace(view, grey=np.full_like(view.grey, level), color=np.full_like(view.color, 2 * level))
        fuse(surfel_map, dull, pose(), k * FRAME_S)
    surfels = surfel_map.surfels()
    np.testing.assert_allclose(surfels.grey, 110.0, atol=0.1)
    np.testing.assert_allclose(surfels.color, 220.0, atol=0.1)


def test_without_color_only_grey_is_known():
    surfel_map, view = made_map(), see([Wall(2.0)], pose())
    surfel_map.fuse(replace(view, color=None), GRID, pose(), 0.0, NOISE)
    surfels = surfel_map.surfels()
    assert (surfels.color == -1).all()
    assert (surfels.grey >= 0).all()
    shown = surfel_map.render(pose(), GRID, SHAPE)
    np.testing.assert_allclose(shown.color, np.repeat(shown.grey[..., None], 3, axis=-1), rtol=1e-4)


def test_a_frame_without_color_leaves_the_colors_as_they_are():
    surfel_map, view = made_map(), see([Wall(2.0)], pose())
    for k, color in enumerate((None, np.full_like(view.color, 80), None, np.full_like(view.color, 120))):
        surfel_map.fuse(replace(view, color=color), GRID, pose(), k * FRAME_S, NOISE)
        expected = (-1, 80, 80, 90)[k]
        np.testing.assert_allclose(surfel_map.surfels().color, expected, atol=0.01)


def test_pixels_that_tell_too_little_are_not_fused():
    surfel_map, view = made_map(far_m=4.0), see([Wall(2.0)], pose())
    depth_m, normal = view.depth_m.copy(), view.normal.copy()
    depth_m[:20] = 0.0
    depth_m[20:40] = np.nan
    depth_m[40:60] = 4.4  # laid as far as 12 standard deviations beyond, 4.29 m
    normal[60:80] = 0.0
    normal[80:100] = [0.0, 0.0, 1.0]
    fused = fuse(surfel_map, replace(view, depth_m=depth_m, normal=normal), pose(), 0.0)
    assert fused.added == len(surfel_map) == 20 * SHAPE[1]


def test_what_went_away_is_removed_and_what_is_behind_stays():
    surfel_map, wall, box = made_map(), Wall(2.5), Wall(1.5, low=-0.2, high=0.2)
    look_at(surfel_map, [wall, box], [pose()] * 15)
    assert np.count_nonzero(surfel_map.surfels("stable").position[:, 2] < 2) > 500
    fused = look_at(surfel_map, [wall], [pose()] * 15, start_s=1.0)
    assert sum(frame.removed for frame in fused) > 500
    left = surfel_map.surfels()
    # At the box's silhouette, pixels beside it belong to the wall: what is only half in free space may stay.
    assert np.count_nonzero(left.position[:, 2] < 2) == 0
    assert np.count_nonzero(left.position[:, 2] > 2) > 0.98 * SHAPE[0] * SHAPE[1]


def test_missing_depth_removes_nothing(monkeypatch):
    monkeypatch.setattr("wheelsight.mapping.surfels._UNSEEN_S", 3.0)
    surfel_map, view = made_map(), see([Wall(2.0)], pose())
    look_at(surfel_map, [Wall(2.0)], [pose()] * 12)
    before = surfel_map.surfels()
    for k in range(20):
        fuse(surfel_map, replace(view, depth_m=np.zeros(SHAPE, np.float32)), pose(), 1.0 + k * FRAME_S)
    np.testing.assert_array_equal(before.confidence, surfel_map.surfels().confidence)


def test_what_stands_behind_a_nearer_thing_is_not_removed(monkeypatch):
    monkeypatch.setattr("wheelsight.mapping.surfels._UNSEEN_S", 3.0)
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.5)], [pose()] * 12)
    before = len(surfel_map)
    look_at(surfel_map, [Wall(1.0)], [pose()] * 12, start_s=1.0)
    assert np.count_nonzero(surfel_map.surfels().position[:, 2] > 2) == before


@pytest.mark.parametrize("looks_on", [True, False], ids=["in view", "out of view"])
@pytest.mark.parametrize(("unstable_s", "unseen_s"), [(1.0, 9.0), (9.0, 1.0)], ids=["made", "last seen"])
def test_surfels_that_never_became_stable_go_after_their_time(monkeypatch, looks_on, unstable_s, unseen_s):
    monkeypatch.setattr("wheelsight.mapping.surfels._UNSTABLE_S", unstable_s)
    monkeypatch.setattr("wheelsight.mapping.surfels._UNSEEN_S", unseen_s)
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * 3)
    assert len(surfel_map) > 0
    T = pose() if looks_on else pose(yaw=np.pi)
    nothing = see([], T)
    fuse(surfel_map, nothing, T, 0.9)
    assert len(surfel_map) > 0
    fuse(surfel_map, nothing, T, 2.0)
    assert len(surfel_map) == 0


def test_a_map_that_settles_has_no_surfels_whose_time_has_come():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * 40)
    look_at(surfel_map, [Wall(2.0), Wall(1.2, low=0.0)], [pose()] * 3, start_s=2.0)
    before = surfel_map.status()
    assert 0 < before.stable < before.surfels
    assert surfel_map.settle() == 0  # they are young
    none = surfel_map.surfels()
    none = Surfels(*(getattr(none, field.name)[:0] for field in fields(Surfels)))
    surfel_map.add(none, 9.0)  # time goes on, and no frame comes
    assert surfel_map.settle() == before.surfels - before.stable
    assert len(surfel_map) == surfel_map.status().stable == before.stable


def test_old_surfels_are_kept_but_not_predicted_and_wake_when_seen_again():
    surfel_map, wall = made_map(active_s=5.0), Wall(2.0)
    look_at(surfel_map, [wall], [pose()] * 40)  # so that corners, which count for a quarter, are stable too
    before = surfel_map.status()
    away = pose(yaw=np.pi)
    fuse(surfel_map, see([], away), away, 20.0)
    assert surfel_map.status().active == 0
    assert not surfel_map.predict(pose(), GRID, SHAPE).depth_m.any()
    assert np.count_nonzero(surfel_map.render(pose(), GRID, SHAPE).depth_m) > 0.98 * SHAPE[0] * SHAPE[1]
    fuse(surfel_map, see([wall], pose()), pose(), 20.1)
    again = surfel_map.status()
    assert again.active > 0.99 * again.surfels
    assert again.surfels <= before.surfels
    assert surfel_map.surfels().first_s.max() < 1.5
    assert surfel_map.predict(pose(), GRID, SHAPE).depth_m.all()


def test_duplicates_become_one_when_seen_again():
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()] * 12)
    once = surfel_map.surfels()
    beside = replace(once, position=once.position + np.array([0.001, 0.001, 0.002], np.float32))
    surfel_map.add(beside, surfel_map.stamp_s)
    assert len(surfel_map) == 2 * len(once.grey)
    fused = look_at(surfel_map, [Wall(2.0)], [pose()] * 3, start_s=1.0)
    assert sum(frame.merged for frame in fused) > 0.9 * len(once.grey)
    assert len(surfel_map) < 1.1 * len(once.grey)


def test_two_surfaces_close_together_do_not_become_one():
    surfel_map = made_map()
    boards = [Wall(2.0, high=0.0), Wall(2.06, low=0.0)]
    look_at(surfel_map, boards, swaying(40))
    z = surfel_map.surfels("stable").position[:, 2]
    assert np.count_nonzero(np.abs(z - 2.0) < 1e-3) > 3000
    assert np.count_nonzero(np.abs(z - 2.06) < 1e-3) > 3000
    assert np.count_nonzero((z > 2.005) & (z < 2.055)) == 0


def contents(surfel_map: SurfelMap) -> list[np.ndarray]:
    return [getattr(surfel_map.surfels(), name) for name in FIELDS]


def test_two_runs_give_the_same_map_to_the_last_bit():
    made = []
    for _ in range(2):
        surfel_map = made_map()
        walls = [Wall(2.5, slope=0.2), Wall(1.5, low=-0.2, high=0.2)]
        look_at(surfel_map, walls, swaying(12), np.random.default_rng(5))
        view = surfel_map.render(pose(0.05, yaw=0.1), GRID, SHAPE)
        made.append([*contents(surfel_map), view.depth_m, view.normal, view.grey, view.color])
    for first, second in zip(*made, strict=True):
        np.testing.assert_array_equal(first, second)


def test_the_count_of_surfels_is_that_of_those_there(monkeypatch, rng):
    monkeypatch.setattr("wheelsight.mapping.surfels._UNSTABLE_S", 0.2)
    surfel_map = made_map()
    for k, T in enumerate(swaying(25)):
        fuse(surfel_map, see([Wall(2.0 + 0.05 * (k % 3))], T, rng), T, k * FRAME_S)
        assert len(surfel_map) == len(surfel_map.surfels().grey)


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"T_map_camera": np.full((4, 4), np.nan)}, "T_map_camera"),
        ({"T_map_camera": 2 * np.eye(4)}, "T_map_camera"),
        ({"T_map_camera": np.eye(3)}, "T_map_camera"),
        ({"intrinsics": np.array([0.0, 1, 1, 1])}, "intrinsics"),
        ({"intrinsics": np.array([np.nan, 1, 1, 1])}, "intrinsics"),
        ({"stamp_s": 0.5}, "stamp_s"),
        ({"stamp_s": np.nan}, "stamp_s"),
        ({"normal": np.zeros((*SHAPE, 2), np.float32)}, "normal"),
        ({"grey": np.zeros((3, 3), np.float32)}, "grey"),
        ({"color": np.zeros(SHAPE, np.float32)}, "color"),
        ({"depth_m": np.zeros(7, np.float32)}, "depth_m"),
    ],
)
def test_what_cannot_be_fused_is_refused_and_leaves_the_map_as_it_was(changed, word):
    surfel_map, view = made_map(), see([Wall(2.0)], pose())
    fuse(surfel_map, view, pose(), 1.0)
    before = contents(surfel_map)
    images = {name: image for name, image in changed.items() if name in FrameSurface.__slots__}
    how = {"intrinsics": GRID, "T_map_camera": pose(), "stamp_s": 2.0} | {
        name: value for name, value in changed.items() if name not in images
    }
    with pytest.raises(MapError, match=word) as raised:
        surfel_map.fuse(replace(view, **images), **how)
    assert "\n" not in str(raised.value)
    for first, second in zip(before, contents(surfel_map), strict=True):
        np.testing.assert_array_equal(first, second)
    assert surfel_map.stamp_s == 1.0


def test_points_lie_where_pixels_saw_them():
    surfel_map, T = made_map(), pose(0.3, -0.2, 0.1, 0.4)
    view = see([Wall(2.0, slope=0.2)], T)
    fuse(surfel_map, view, T, 0.0)
    expected = (rays() * view.depth_m[..., None]).reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
    distance, nearest = KDTree(surfel_map.surfels().position).query(expected)
    assert distance.max() < 1e-5
    assert len(np.unique(nearest)) == len(expected) == len(surfel_map)
