"""Where faces meet in a picture, a pixel shows the mean of what it covers; everywhere else, what its middle shows."""

from __future__ import annotations

from dataclasses import replace

import cv2
import mujoco
import numpy as np
import pytest
from numpy.typing import ArrayLike
from odometry.plain_kernels import plain
from small_rooms import looking, room

from wheelsight.core.geometry import BoolArray, Float32Array, FloatArray, PinholeCamera, se3
from wheelsight.core.trajectory import Trajectory
from wheelsight_sim import Drive, Renderer, SimulationSettings, build_world, camera_model
from wheelsight_sim import view_kernels as kernels
from wheelsight_sim.appearance import Painter
from wheelsight_sim.scene import Outlines, Scene, View
from wheelsight_sim.world import Surface, World

CAMERA = PinholeCamera(80, 60, 70, 70, 39.5, 29.5)
BENT = replace(CAMERA, distortion=(0.2, -0.3, 0.002, -0.001, 0.1))
FINER = 8
PAINTS = {"white": Surface("plain", (0.8, 0.8, 0.8)), "black": Surface("plain", (0.05, 0.1, 0.2))}
WALL = '<geom name="wall" type="box" pos="5 0 1" size="0.1 9 9" material="black"/>'


def panel(tilt_deg: float) -> str:
    """A sheet on a wall, turned in its plane, so wide that only two opposite edges of it are seen."""
    return f'<geom name="panel" type="box" pos="4.85 0 1" size="0.02 0.9 9" euler="{tilt_deg} 0 0"/>'


def finer(camera: PinholeCamera, times: int = FINER) -> PinholeCamera:
    """The same camera with so many pixels in place of one, each way."""
    cx, cy = (times * (c + 0.5) - 0.5 for c in (camera.cx, camera.cy))
    size, focal = (camera.width * times, camera.height * times), (camera.fx * times, camera.fy * times)
    return replace(camera, width=size[0], height=size[1], fx=focal[0], fy=focal[1], cx=cx, cy=cy)


def painted(world: World, camera: PinholeCamera, T: FloatArray) -> tuple[Float32Array, Float32Array, BoolArray]:
    """A picture with outlines and one without, and where the two may differ."""
    scene = Scene(world, threads=1)
    view = scene.cast(camera, T)
    outlines, painter = scene.outlines(view), Painter(scene.geoms, scene.surfaces, 1, threads=1)
    at_outline = np.zeros(view.geom.shape, bool)
    at_outline[tuple(outlines.pixels.T)] = True
    return painter.paint(view, outlines=outlines), painter.paint(view), at_outline


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


SHEETS: list[tuple[object, str, float]] = [
    (tilt, WALL + panel(tilt), at_most) for tilt, at_most in ((1, 0.04), (5, 0.04), (-30, 0.08), (70, 0.07))
]
THINGS: list[tuple[object, str, float]] = [
    ("before nothing", panel(7), 0.045),
    ("faces of a box", '<geom name="box" type="box" pos="3 0 1" size="1 1 9" euler="2 3 40"/>', 0.04),
    ("round", WALL + '<geom name="ball" type="sphere" pos="4 0.5 1.1" size="0.8"/>', 0.055),
]


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
@pytest.mark.parametrize(("name", "geoms", "at_most"), SHEETS + THINGS, ids=lambda value: str(value)[:14])
def test_an_outline_is_as_bright_as_what_each_side_covers(
    name: object, geoms: str, at_most: float, camera: PinholeCamera
) -> None:
    """RMS over the picture's range, against the mean of 64 pixels for each; one ray a pixel is off by 12 to 18 %."""
    smooth, ragged, at_outline = painted(room(geoms, PAINTS), camera, looking())
    _, fine, _ = painted(room(geoms, PAINTS), finer(camera), looking())
    mean = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    span = float(fine.max() - fine.min())
    assert at_outline.sum() > 50
    assert rms((smooth - mean)[at_outline]) < at_most * span
    assert rms((ragged - mean)[at_outline]) > 0.12 * span


def test_the_mean_is_of_the_rays_that_see_each_side() -> None:
    scene = Scene(room(WALL + panel(5), PAINTS), threads=1)
    view = scene.cast(CAMERA, looking())
    outlines, painter = scene.outlines(view), Painter(scene.geoms, scene.surfaces, 1, threads=1)
    at = tuple(outlines.pixels.T)
    picture = painter.paint(view)
    on_panel = np.concatenate([view.geom[at][:, None], outlines.samples.geom], axis=1) == 1
    # Light hardly changes along a row, and both materials are of one colour all over.
    rows = [[picture[row, geom == g].mean(axis=0) for row, geom in enumerate(view.geom)] for g in (1, 0)]
    white, black = np.array(rows)[:, outlines.pixels[:, 0]]
    share = on_panel.mean(axis=1)[:, None]
    assert set(np.round(5 * share.ravel())) >= {1, 2, 3, 4}
    np.testing.assert_allclose(
        painter.paint(view, outlines=outlines)[at], share * white + (1 - share) * black, atol=0.03
    )


def moving(rows: int, twist: ArrayLike = (0, 0, 0.03, 0, 0.05, 0)) -> FloatArray:
    """Poses of the rows of a rolling shutter while the camera goes ahead and turns."""
    return looking(6, 1.4, 1.0) @ se3.exp(np.linspace(-0.5, 0.5, rows)[:, None] * np.asarray(twist, float))


def test_only_pixels_beside_another_face_change() -> None:
    scene = Scene(build_world("floor4", 5), threads=1)
    camera = PinholeCamera(160, 120, 146, 146, 79.5, 59.5)
    view = scene.cast(camera, moving(120))
    before = view.depth_m.tobytes(), view.geom.tobytes(), view.normal_world.tobytes()
    outlines, painter = scene.outlines(view), Painter(scene.geoms, scene.surfaces, 5, threads=1)
    smooth, ragged = painter.paint(view, outlines=outlines), painter.paint(view)
    assert (view.depth_m.tobytes(), view.geom.tobytes(), view.normal_world.tobytes()) == before

    expected = np.zeros((120, 160), bool)
    for axis in (0, 1):
        first, second = np.delete(np.arange(expected.shape[axis]), -1), np.delete(np.arange(expected.shape[axis]), 0)
        geom, n = ([np.take(image, i, axis) for i in (first, second)] for image in (view.geom, view.normal_world))
        another = (geom[0] != geom[1]) | ((n[0] * n[1]).sum(axis=-1) < 0.9)
        for i in (first, second):
            where = np.ix_(*(i if k == axis else np.arange(expected.shape[k]) for k in (0, 1)))
            expected[where] |= another
    found = np.zeros_like(expected)
    found[tuple(outlines.pixels.T)] = True
    np.testing.assert_array_equal(found, expected)
    assert 0.02 < found.mean() < 0.3
    np.testing.assert_array_equal(smooth[~found], ragged[~found])
    assert (smooth != ragged)[found].any(axis=-1).mean() > 0.2


def test_frames_have_smooth_outlines_and_the_depth_they_had(monkeypatch: pytest.MonkeyPatch) -> None:
    world, settings = (
        build_world("square", 3),
        SimulationSettings(world="square", size=(160, 120), rate_hz=10.0, seed=3),
    )
    stamps_s = np.arange(0, 1, 0.005)
    x, y = world.route[0]
    arc = se3.from_plane(x, y, 0.3) @ se3.exp(stamps_s[:, None] * [0.5, 0, 0, 0, 0, 0.4])
    drive = Drive(Trajectory(stamps_s, arc, body="base"), ())

    def frame() -> tuple[FloatArray, Float32Array]:
        made = Renderer(world, drive, settings, camera_model(settings.camera, settings.size)).frame(4)
        return made.color.astype(float), made.depth_m

    color, depth_m = frame()
    monkeypatch.setattr(Scene, "outlines", lambda scene, view: None)
    ragged, ragged_depth_m = frame()
    np.testing.assert_array_equal(depth_m, ragged_depth_m)
    changed = (abs(color - ragged) > 8).any(axis=-1)
    assert 0.001 < changed.mean() < 0.2


CLUTTER = (
    '<geom name="floor" type="plane" size="20 20 1"/>'
    '<geom name="back" type="box" pos="9 0 1" size="0.1 9 9" material="black"/>'
)


def cluttered(rng: np.random.Generator, count: int = 200) -> World:
    geoms = [CLUTTER]
    for i in range(count):
        place, size, turn = rng.uniform((2, -5, 0), (8, 5, 3)), rng.uniform(0.03, 0.3, 3), rng.uniform(-180, 180, 3)
        kind, numbers = (
            ("box", "cylinder", "ellipsoid")[i % 3],
            (" ".join(f"{x:.3f}" for x in v) for v in (place, size, turn)),
        )
        geoms.append('<geom name="g{}" type="{}" pos="{}" size="{}" euler="{}"/>'.format(i, kind, *numbers))
    return room("".join(geoms), PAINTS)


@pytest.mark.parametrize("twist", [(0, 0, 0, 0, 0, 0), (0, 0, 0.03, 0, 0.05, 0)], ids=["still", "moving"])
def test_rays_at_outlines_miss_nothing(rng: np.random.Generator, twist: ArrayLike) -> None:
    scene = Scene(cluttered(rng))
    T_rows = looking() @ se3.exp(np.linspace(-0.5, 0.5, 60)[:, None] * np.asarray(twist, float))
    outlines = scene.outlines(scene.cast(CAMERA, T_rows))
    samples, geom = outlines.samples, np.zeros(1, np.int32)
    hits: list[int] = []
    depths: list[float] = []
    np.testing.assert_array_equal(samples.T_world_camera, T_rows[outlines.pixels[:, 0]])
    for row, sample in np.ndindex(samples.geom.shape):
        T = samples.T_world_camera[row]
        ray, origin = T[:3, :3] @ samples.rays[row, sample], np.ascontiguousarray(T[:3, 3])
        depths.append(max(mujoco.mj_ray(scene.model, scene.data, origin, ray, None, True, -1, geom), 0))
        hits.append(geom[0])
    same, depths_m = samples.geom.ravel() == hits, np.array(depths)
    # Rays of one tile start where its middle row does: what is seen edge on may be hit from there and not from its own.
    assert same.mean() >= (0.99 if np.any(twist) else 1.0)
    error = abs(samples.depth_m.ravel() - depths_m)[same] / np.maximum(depths_m[same], 1)
    assert np.median(error) < 1e-6
    assert np.any(twist) or error.max() < 1e-6
    assert len(outlines.pixels) > 500


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["straight", "bent"])
def test_rays_go_through_parts_of_their_pixels(camera: PinholeCamera) -> None:
    rays, pixels = camera.rays(), np.array([[0, 0], [0, 40], [30, 0], [29, 41], [59, 79]], np.int32)
    spread = kernels.spread(rays, pixels)
    px = camera.project(spread.reshape(-1, 3))[0].reshape(*spread.shape[:2], 2)
    off = px - pixels[:, None, ::-1]
    np.testing.assert_allclose(off, np.broadcast_to(kernels.OFFSETS, off.shape), atol=0.01)
    # One ray, that of the middle among them, in each fifth of a pixel.
    fifths = np.sort(np.round(5 * np.concatenate([off, np.zeros_like(off[:, :1])], axis=1)), axis=1)
    np.testing.assert_array_equal(fifths, np.broadcast_to(np.arange(-2, 3)[:, None], fifths.shape))


def test_threads_do_not_change_a_byte(rng: np.random.Generator) -> None:
    world, T_rows = cluttered(rng), moving(60) @ looking(-6, -1.4, 0)
    pictures = []
    for threads in (1, 2, 3):
        scene = Scene(world, threads=threads)
        view = scene.cast(CAMERA, T_rows)
        outlines, painter = scene.outlines(view), Painter(scene.geoms, scene.surfaces, 1, threads=threads)
        pictures.append((outlines.samples.depth_m.tobytes(), painter.paint(view, outlines=outlines).tobytes()))
    assert pictures[0] == pictures[1] == pictures[2]


def test_compiled_search_is_plain_search(rng: np.random.Generator) -> None:
    view = Scene(cluttered(rng)).cast(PinholeCamera(24, 18, 20, 20, 11.5, 8.5), looking())
    tiles = np.array([[0, 10, 3, 24], [10, 18, 3, 24]])
    pixels, ends = kernels.find(view.geom, view.normal_world, tiles)
    np.testing.assert_array_equal(pixels, plain(kernels).find(view.geom, view.normal_world, tiles)[0])
    assert (pixels[: ends[1], 0] < 10).all()
    assert (pixels[ends[1] :, 0] >= 10).all()
    np.testing.assert_array_equal(kernels.spread(view.rays, pixels), plain(kernels).spread(view.rays, pixels))
    assert len(pixels) > 50
    assert (pixels[:, 1] >= 3).all()


def test_what_has_no_outlines_is_as_it_was() -> None:
    scene = Scene(room(WALL, PAINTS))
    view: View = scene.cast(CAMERA, looking())
    outlines: Outlines = scene.outlines(view)
    assert outlines.pixels.shape == (0, 2)
    painter = Painter(scene.geoms, scene.surfaces, 1)
    assert painter.paint(view, outlines=outlines).tobytes() == painter.paint(view).tobytes()
