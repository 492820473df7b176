from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from odometry.plain_kernels import plain
from small_rooms import looking, room, wall

from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight_sim import sensor_kernels as kernels
from wheelsight_sim.depth_sensor import DepthSensor, IdealDepth, StructuredLight, TimeOfFlight
from wheelsight_sim.scene import Scene, View
from wheelsight_sim.world import Surface

V1 = PinholeCamera(320, 240, 586, 586, 159.5, 119.5)
V2 = PinholeCamera(256, 212, 365.5, 365.5, 127.5, 105.5)
HALF_V1 = PinholeCamera(320, 240, 293, 293, 159.5, 119.5)
SENSORS = [(StructuredLight(), V1), (StructuredLight(), HALF_V1), (TimeOfFlight(), V2)]
IDS = ["structured light", "structured light at half size", "time of flight"]
# The inner part, which no border and no shadow of one reaches.
INNER = (slice(20, -20), slice(60, -60))


def seen(geoms: str, camera: PinholeCamera, T: FloatArray | None = None) -> View:
    return Scene(room(geoms), threads=1).cast(camera, looking() if T is None else T)


def measured(
    sensor: DepthSensor, view: View, camera: PinholeCamera, infrared: float = 0.6, shine: float = 0.0, seed: int = 1
) -> Float32Array:
    count = max(int(view.geom.max()) + 1, 1)
    light, mirror = np.full(count, infrared), np.full(count, shine)
    return sensor.measure(view, camera, light, mirror, np.random.default_rng(seed))


def errors_on_wall(
    sensor: DepthSensor, camera: PinholeCamera, distance_m: float, tilt_rad: float, **light: Any
) -> FloatArray:
    """(N,) errors of the inner pixels, each over the square of its true depth."""
    view = seen(wall(distance_m, tilt_rad), camera)
    depth_m = measured(sensor, view, camera, **light)[INNER].astype(float)
    true_m = view.depth_m[INNER].astype(float)
    assert (depth_m > 0).mean() > 0.98
    good = depth_m > 0
    return (depth_m - true_m)[good] / true_m[good] ** 2


@pytest.mark.parametrize("distance_m", [1.0, 1.5, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("camera", [V1, HALF_V1], ids=["native", "half size"])
def test_structured_light_has_the_noise_khoshelham_and_elberink_publish(
    camera: PinholeCamera, distance_m: float
) -> None:
    # Turned a little, so that disparities meet all parts of a step of rounding.
    errors = errors_on_wall(StructuredLight(oblique_m=0.0), camera, distance_m, 0.1)
    rounding_m = 1e-3 / np.sqrt(12)
    published = np.hypot(1.425e-3, rounding_m / distance_m**2)
    assert errors.std() == pytest.approx(published, rel=0.1)
    assert abs(errors.mean()) < 0.1 * published


@pytest.mark.parametrize("distance_m", [1.0, 1.5, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.7])
def test_time_of_flight_has_the_noise_fankhauser_et_al_publish(distance_m: float, tilt_rad: float) -> None:
    view = seen(wall(distance_m, tilt_rad), V2)
    depth_m, true_m = measured(TimeOfFlight(), view, V2).astype(float)[INNER], view.depth_m.astype(float)[INNER]
    # Incidence by hand: the wall's normal is (-cos, -sin, 0) of its tilt in the world, camera's z is the world's x.
    x, y = V2.rays()[INNER][..., 0], V2.rays()[INNER][..., 1]
    theta = np.arccos((np.cos(tilt_rad) - x * np.sin(tilt_rad)) / np.sqrt(1 + x**2 + y**2))
    sigma_mm = 1.5 - 0.5 * true_m + 0.3 * true_m**2 + 0.1 * true_m**1.5 * theta**2 / (np.pi / 2 - theta) ** 2
    sigma_mm = np.hypot(sigma_mm, 1 / np.sqrt(12))
    good = depth_m > 0
    assert good.mean() > 0.99
    normalised = 1000 * (depth_m - true_m)[good] / sigma_mm[good]
    assert normalised.std() == pytest.approx(1, rel=0.05)
    assert abs(normalised.mean()) < 0.05


def test_time_of_flight_is_noisier_where_less_light_returns() -> None:
    light, dark = (errors_on_wall(TimeOfFlight(), V2, 2.5, 0.0, infrared=share) for share in (0.6, 0.15))
    assert dark.std() == pytest.approx(2 * light.std(), rel=0.05)


def test_structured_light_is_noisier_on_oblique_surfaces() -> None:
    frontal, oblique = (errors_on_wall(StructuredLight(), V1, 1.0, tilt) for tilt in (0.1, 1.2))
    # Nguyen et al.: 0.1 mm · θ²/(π/2 - θ)² at a metre, beside 1.4 mm.
    extra = 1e-4 * 1.2**2 / (np.pi / 2 - 1.2) ** 2
    assert oblique.std() == pytest.approx(np.hypot(frontal.std(), extra), rel=0.15)
    assert oblique.std() > 1.1 * frontal.std()


def test_noise_of_block_matching_is_alike_in_neighbours_and_that_of_single_pixels_is_not() -> None:
    # So far that rounding would hide it: finer steps.
    sensor = StructuredLight(steps_per_px=1e4)
    view = seen(wall(2.0), V1)
    error = (measured(sensor, view, V1) - view.depth_m)[INNER]
    error = error - error.mean()
    near, far = ((error[:, :-d] * error[:, d:]).mean() / error.var() for d in (1, 12))
    assert 0.7 < near < 0.95
    assert abs(far) < 0.1
    view = seen(wall(2.0), V2)
    error = (measured(TimeOfFlight(), view, V2) - view.depth_m)[INNER]
    assert abs((error[:, :-1] * error[:, 1:]).mean() / error.var()) < 0.05


def test_structured_light_measures_eighths_of_a_pixel_in_whole_millimetres() -> None:
    view = seen(wall(3.0, 0.2), V1)
    depth_m = measured(StructuredLight(), view, V1).astype(float)
    depth_m = depth_m[depth_m > 0]
    np.testing.assert_allclose(1000 * depth_m, np.round(1000 * depth_m), atol=1e-3)
    eighths = 8 * 586 * 0.075 / depth_m
    # A millimetre at 3 m is 0.04 eighths; half of it is what rounding to millimetres leaves.
    assert np.abs(eighths - np.round(eighths)).max() < 0.03
    steps = np.diff(np.unique(depth_m))
    at = np.unique(depth_m)[:-1]
    assert np.median(steps / at**2) == pytest.approx(2.85e-3, rel=0.1), "Khoshelham & Elberink's depth resolution"


BOX_AND_WALL = '<geom name="front" type="box" pos="{x} 0 1" size="0.001 0.15 0.3"/>' + wall(3.0)


@pytest.mark.parametrize(("sensor", "camera"), SENSORS[:2], ids=IDS[:2])
@pytest.mark.parametrize("near_m", [1.2, 1.8])
def test_a_shadow_lies_left_of_what_throws_it_and_has_the_width_of_the_disparities_difference(
    sensor: StructuredLight, camera: PinholeCamera, near_m: float
) -> None:
    view = seen(BOX_AND_WALL.format(x=near_m + 0.001), camera)
    depth_m = measured(sensor, view, camera)
    expected_px = camera.fx * 0.075 * (1 / near_m - 1 / 3.0)
    box_rows = np.flatnonzero((view.geom == 0).sum(axis=1) > 10)[4:-4]
    left = np.flatnonzero(view.geom[120] == 0)[0]
    holes = depth_m[box_rows] == 0
    widths = holes[:, : left + 8].sum(axis=1)
    assert widths.mean() == pytest.approx(expected_px, abs=1.0)
    right = np.flatnonzero(view.geom[120] == 0)[-1]
    assert holes[:, right + 4 : right + 40].mean() < 0.01
    assert holes[:, left - int(0.7 * expected_px) : left - int(0.3 * expected_px)].mean() > 0.95


def test_light_passes_behind_a_thin_pole() -> None:
    pole = '<geom name="pole" type="box" pos="1.001 0 1" size="0.001 0.01 1"/>'
    view = seen(pole + wall(3.0), V1)
    lit = kernels.lit_by_projector(view.depth_m, view.geom, V1.fx * 0.075, 1.0)
    row, left = lit[120], np.flatnonzero(view.geom[120] == 0)[0]
    apart = V1.fx * 0.075 * (1 - 1 / 3)
    width = (view.geom[120] == 0).sum()
    dark = np.flatnonzero(~row)
    assert len(dark) == pytest.approx(width, abs=1)
    assert dark.mean() == pytest.approx(left + (width - 1) / 2 - apart, abs=1)


def test_smooth_slopes_throw_no_shadow_on_themselves() -> None:
    for tilt in (-1.2, -0.6, 0.6, 1.2):
        view = seen(wall(1.5, tilt), V1)
        lit = kernels.lit_by_projector(view.depth_m, view.geom, V1.fx * 0.075, 1.0)
        assert lit[view.depth_m > 0.5].all()


def test_edges_are_ragged_by_a_pixel_or_so() -> None:
    view = seen(BOX_AND_WALL.format(x=1.5), V1)
    depth_m = measured(StructuredLight(), view, V1)
    rows = np.flatnonzero((view.geom == 0).sum(axis=1) > 10)[6:-6]
    right = np.flatnonzero(view.geom[120] == 0)[-1]
    is_box = (depth_m[rows] > 1.2) & (depth_m[rows] < 2)
    edges = np.array([np.flatnonzero(row)[-1] for row in is_box]) - right
    assert 0.4 < edges.std() < 1.5
    assert abs(edges.mean()) < 1
    ideal = measured(IdealDepth(), view, V1)[rows]
    assert (((ideal > 1) & (ideal < 2)).sum(axis=1) == (view.geom[rows] == 0).sum(axis=1)).all()


@pytest.mark.parametrize(("sensor", "camera"), SENSORS, ids=IDS)
def test_grazing_surfaces_return_nothing(sensor: StructuredLight | TimeOfFlight, camera: PinholeCamera) -> None:
    floor = '<geom name="floor" type="plane" size="9 9 1"/>'
    # Light enough for the angle alone to decide, in a camera close over the floor.
    sensor = replace(sensor, least_light=0.0)
    view = seen(floor, camera, looking(z=0.35, pitch=0.25))
    theta = np.degrees(np.arccos(0.35 / np.linalg.norm(view.rays * view.depth_m[..., None], axis=-1).clip(0.35)))
    depth_m = measured(sensor, view, camera)
    hit = view.depth_m > 0.6
    assert (depth_m[hit & (theta < 72)] > 0).mean() > 0.98
    assert (depth_m[hit & (theta > 85)] == 0).all()


@pytest.mark.parametrize(("sensor", "camera"), SENSORS, ids=IDS)
def test_dark_surfaces_return_nothing_from_afar(sensor: DepthSensor, camera: PinholeCamera) -> None:
    near, far = seen(wall(1.5), camera), seen(wall(5.5), camera)
    assert (measured(sensor, near, camera, infrared=0.05)[INNER] > 0).mean() > 0.98
    assert (measured(sensor, far, camera, infrared=0.05)[INNER] == 0).all()
    assert (measured(sensor, far, camera, infrared=0.6)[INNER] > 0).mean() > 0.98
    assert (measured(sensor, near, camera, infrared=0.0)[INNER] == 0).all()


@pytest.mark.parametrize(("sensor", "camera"), SENSORS, ids=IDS)
def test_mirrors_return_nothing_and_polish_blinds_where_seen_frontally(
    sensor: DepthSensor, camera: PinholeCamera
) -> None:
    frontal, turned = seen(wall(2.0), camera), seen(wall(2.0, 0.6), camera)
    for view in (frontal, turned):
        assert (measured(sensor, view, camera, shine=0.99)[INNER] == 0).all()
    polished = measured(sensor, frontal, camera, shine=0.5)
    x, y = camera.rays()[..., 0], camera.rays()[..., 1]
    angle = np.degrees(np.arctan(np.hypot(x, y)))
    inner = np.zeros(polished.shape, bool)
    inner[INNER] = True
    assert (polished[angle < 2.5] == 0).all()
    assert (polished[inner & (angle > 8)] > 0).mean() > 0.98
    assert (measured(sensor, turned, camera, shine=0.5)[INNER] > 0).mean() > 0.98


@pytest.mark.parametrize(
    ("sensor", "camera", "near_m", "far_m"),
    [(StructuredLight(), V1, 0.45, 10.0), (TimeOfFlight(), V2, 0.5, 8.0), (IdealDepth(), V1, 0.05, 20.0)],
)
def test_nothing_is_returned_from_out_of_range(
    sensor: DepthSensor, camera: PinholeCamera, near_m: float, far_m: float
) -> None:
    for distance_m, share in ((0.9 * near_m, 0.0), (1.2 * near_m, 1.0), (0.9 * far_m, 1.0), (1.05 * far_m, 0.0)):
        depth_m = measured(sensor, seen(wall(distance_m), camera), camera, infrared=1.0)[INNER]
        assert (depth_m > 0).mean() == pytest.approx(share, abs=0.05)
    empty = seen('<geom name="behind" type="sphere" size="1" pos="-5 0 0"/>', camera)
    assert (measured(sensor, empty, camera) == 0).all()


def test_flying_pixels_lie_between_and_only_beside_edges() -> None:
    view = seen(BOX_AND_WALL.format(x=1.501), V2)
    depth_m = measured(TimeOfFlight(edge_loss=0.0), view, V2)
    flying = (depth_m > 1.55) & (depth_m < 2.95)
    is_box = view.geom == 0
    beside = np.zeros(is_box.shape, bool)
    for axis in (0, 1):
        for shift in (-1, 1):
            beside |= np.roll(is_box, shift, axis) != is_box
    assert flying.sum() > 0.3 * beside.sum()
    assert not (flying & ~beside).any()
    hit = depth_m > 0
    assert depth_m[hit].min() > 1.48
    assert depth_m[hit].max() < 3.03
    lossy = measured(TimeOfFlight(edge_loss=0.5), view, V2)
    assert (lossy[beside] == 0).mean() == pytest.approx(0.5, abs=0.1)
    # A wall seen obliquely has steps between pixels too, but no edges.
    slope = seen(wall(2.0, 1.2), V2)
    assert (measured(TimeOfFlight(edge_loss=1.0), slope, V2)[INNER] > 0).mean() > 0.99


def test_light_mixes_by_brightness() -> None:
    """Half of a pixel's light, at most, comes from across; what is four times as bright counts four times."""
    depth_m = np.array([[1.0, 1.0, 2.0, 2.0]], np.float32)
    geom, usable = np.zeros((1, 4), np.int32), np.ones((1, 4), bool)
    cosine, light = np.ones((1, 4), np.float32), np.array([[0.4, 0.4, 0.1, 0.1]], np.float32)
    chance = np.full((1, 4, 3), 128, np.uint8)
    phase = kernels.Phase(np.zeros(4), reference=0.6, jump=0.03, edge_share=0.5, edge_loss=0.0)
    pixels, noise = kernels.Seen(depth_m, geom, cosine, light), np.zeros((1, 4), np.float32)
    mixed = kernels.time_light(pixels, usable, np.ones(1), noise, chance, phase)[0]
    own, other = 0.75, 0.25
    assert mixed[1] == pytest.approx((own * 0.4 + other * 0.1 * 2) / (own * 0.4 + other * 0.1), abs=6e-4)
    assert mixed[2] == pytest.approx((own * 0.1 * 2 + other * 0.4) / (own * 0.1 + other * 0.4), abs=6e-4)
    assert mixed[0] == 1
    assert mixed[3] == 2


def test_the_ideal_camera_is_exact() -> None:
    view = seen(BOX_AND_WALL.format(x=1.5), V1)
    np.testing.assert_array_equal(measured(IdealDepth(), view, V1, shine=1.0, infrared=0.0), view.depth_m)


@pytest.mark.parametrize(("sensor", "camera"), SENSORS, ids=IDS)
def test_the_same_numbers_make_the_same_image(sensor: DepthSensor, camera: PinholeCamera) -> None:
    view = seen(BOX_AND_WALL.format(x=1.5), camera)
    first, again, other = (measured(sensor, view, camera, seed=seed) for seed in (1, 1, 2))
    assert first.dtype == np.float32
    assert first.shape == view.depth_m.shape
    assert first.tobytes() == again.tobytes()
    assert (first != other).mean() > 0.2


def test_kernels_do_as_they_are_written() -> None:
    camera = PinholeCamera(40, 24, 40, 40, 19.5, 11.5)
    floor = '<geom name="floor" type="plane" size="9 9 1"/>'
    view = seen(floor + BOX_AND_WALL.format(x=1.5), camera, looking(pitch=0.3))
    rng = np.random.default_rng(3)
    slow = plain(kernels)
    scattered, shine = np.array([0.5, 0.6, 0.2]), np.array([0.0, 0.4, 0.1])
    pixels = kernels.returned_light(view, scattered)
    for fast, same in zip(pixels, slow.returned_light(view, scattered), strict=True):
        np.testing.assert_allclose(fast, same, rtol=1e-5)
    lit = (view.depth_m, view.geom, 30.0, 0.5)
    np.testing.assert_array_equal(kernels.lit_by_projector(*lit), slow.lit_by_projector(*lit))
    chance = kernels.Chance(rng.integers(0, 256, (24, 40, 3), np.uint8), 1.0)
    found = (pixels, shine, chance, kernels.Limits(0.5, 8.0, 0.15, 0.02, 0.1, 0.25))
    usable = kernels.detectable(*found)
    np.testing.assert_array_equal(usable, slow.detectable(*found))
    assert 0.2 < usable.mean() < 0.99
    noise, shifts = rng.standard_normal((24, 40)).astype(np.float32), rng.normal(0, 1, 256)
    match = (pixels, usable, noise, chance, shifts, kernels.Pattern(0.05, 1e-4, 30.0, 40.0, 8.0))
    np.testing.assert_allclose(kernels.match_pattern(*match), slow.match_pattern(*match), atol=1.1e-3)
    axial = np.array([1.5e-3, -0.5e-3, 0.3e-3, 0.1e-3])
    time = (pixels, usable, scattered, noise, chance.cells, kernels.Phase(axial, 0.6, 0.03, 0.5, 0.3))
    np.testing.assert_allclose(kernels.time_light(*time), slow.time_light(*time), atol=1.1e-3)


def test_each_geom_has_its_own_surface() -> None:
    surfaces = {"white": Surface("plain", (1, 1, 1)), "black": Surface("plain", (0, 0, 0), infrared=0.03)}
    geoms = wall(3.0) + '<geom name="front" type="box" pos="2 0 1" size="0.1 0.3 0.3" material="black"/>'
    scene = Scene(room(geoms, surfaces), threads=1)
    view = scene.cast(V1, looking())
    infrared = np.array([scene.surfaces[name].infrared for name in scene.geoms.materials])
    depth_m = StructuredLight(least_light=0.02).measure(view, V1, infrared, np.zeros(2), np.random.default_rng(0))
    assert (depth_m[120, 130:190] == 0).all()
    assert (depth_m[20, 60:] > 2.9).all()
