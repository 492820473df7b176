"""Textures are the same by seed, stick to their surfaces, do not alias, and give keypoints where rooms have them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest
from odometry.plain_kernels import plain
from simulation.boxes import SURFACES, albedo_painter, boxes, corridor, heading, see

from wheelsight.core.errors import ConfigError
from wheelsight.core.geometry import Float32Array, FloatArray, PinholeCamera
from wheelsight_sim import light_kernels as _light_kernels
from wheelsight_sim import texture_kernels as _picture_kernels
from wheelsight_sim import texture_kernels as _texture_kernels
from wheelsight_sim import texture_kernels as _wall_kernels
from wheelsight_sim import view_kernels as _outline_kernels
from wheelsight_sim import view_kernels as _paint_kernels
from wheelsight_sim.appearance import Painter
from wheelsight_sim.color_sensor import ColorSensor
from wheelsight_sim.scene import Geoms, Outlines, Scene, View
from wheelsight_sim.world import Surface
from wheelsight_sim.worlds import build_world

PATTERNED = sorted(set(SURFACES) - {"blank", "wall"})


def facing(material: str) -> Geoms:
    """A piece of a material 2 m wide and high, its face at x = 0."""
    return boxes(("piece", material, (0.5, 0, 1.2), (0.5, 1, 1)))


def keypoints(geoms: Geoms, view: View, surfaces: Mapping[str, Surface] = SURFACES, seed: int = 1) -> int:
    sensor = ColorSensor()
    radiance = Painter(geoms, surfaces, seed).paint(view)
    image = sensor.expose(radiance, view, sensor.meter(radiance), np.random.default_rng(seed))
    return len(cv2.ORB.create(2000).detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None))


def plain_kernels() -> SimpleNamespace:
    """The painter's kernels of all six modules as plain Python."""
    everything = ModuleType("everything")
    lower = _texture_kernels, _outline_kernels, _light_kernels, _picture_kernels, _wall_kernels
    for module in (*lower, _paint_kernels):
        vars(everything).update({k: v for k, v in vars(module).items() if not k.startswith("__")})
    return plain(everything)


def test_the_same_seed_paints_the_same_bytes_with_any_number_of_threads() -> None:
    geoms, view = corridor(), see(corridor(), heading(0, 0, 1), (80, 60), 72)
    first = Painter(geoms, SURFACES, 5, threads=1).paint(view)
    for threads in (1, 2, 3):
        assert Painter(geoms, SURFACES, 5, threads=threads).paint(view).tobytes() == first.tobytes()


def test_another_seed_paints_other_textures_and_other_light() -> None:
    geoms, view = corridor(), see(corridor(), heading(0, 0, 1), (80, 60), 72)
    one, other = (Painter(geoms, SURFACES, seed).paint(view) for seed in (5, 6))
    assert np.abs(one / one.mean() - other / other.mean()).mean() > 0.02
    assert abs(one.mean() / other.mean() - 1) > 0.01


@pytest.mark.parametrize("shape", [6, 5], ids=["box", "cylinder"])
@pytest.mark.parametrize("material", sorted(SURFACES))
def test_compiled_painting_is_plain_painting(
    material: str, shape: int, plainly: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    geoms = facing(material)
    view = see(geoms, heading(-1.7, 0.1, 1.3, 0.1, 0.05), (13, 9), 8)
    geoms = replace(geoms, kind=np.array([shape], np.int32))
    painter = Painter(geoms, SURFACES, 3, threads=1)
    compiled = painter.paint(view)
    monkeypatch.setattr(_paint_kernels, "paint_rows", plainly.paint_rows)
    np.testing.assert_allclose(painter.paint(view), compiled, atol=1e-6)


def test_compiled_outlines_are_plain_outlines(plainly: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    geoms, size = corridor(), (24, 18)
    view, aside = (see(geoms, heading(0, 0, 1, yaw), size, 20) for yaw in (0.0, 0.05))
    pixels = np.stack(np.meshgrid(np.arange(18), np.arange(24), indexing="ij"), -1).reshape(-1, 2).astype(np.int32)
    samples = View(
        aside.depth_m.reshape(-1, 1),
        aside.geom.reshape(-1, 1),
        aside.normal_world.reshape(-1, 1, 3),
        aside.T_world_camera[pixels[:, 0]],
        aside.rays.reshape(-1, 1, 3),
    )
    painter, outlines = Painter(geoms, SURFACES, 3, threads=1), Outlines(pixels, samples)
    compiled = painter.paint(view, outlines=outlines)
    monkeypatch.setattr(_paint_kernels, "paint_outlines", plainly.paint_outlines)
    np.testing.assert_allclose(painter.paint(view, outlines=outlines), compiled, atol=1e-6)
    assert (compiled != painter.paint(view)).any(axis=-1).mean() > 0.1


@pytest.fixture(scope="module")
def plainly() -> SimpleNamespace:
    return plain_kernels()


@pytest.mark.parametrize("material", PATTERNED)
def test_far_and_slanting_textures_do_not_alias(material: str) -> None:
    geoms, T = facing(material), heading(-3.5, 1.6, 1.3, -0.42)
    painter, times = albedo_painter(geoms), 8
    once = see(geoms, T, (72, 54), 60)
    often = see(geoms, T, (72 * times, 54 * times), 60 * times)
    fine = painter.paint(often)
    mean = fine.reshape(54, times, 72, times, 3).mean((1, 3))
    points = fine[times // 2 :: times, times // 2 :: times]
    inside = cv2.erode((often.geom == 0).astype(np.uint8), np.ones((3 * times, 3 * times)))[4::8, 4::8] > 0
    faded = rms(painter.paint(once)[inside] - mean[inside])
    assert inside.sum() > 300
    assert faded < 0.08
    assert faded < 0.65 * rms(points[inside] - mean[inside])


def rms(errors: Float32Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("material", sorted(SURFACES))
def test_a_texture_stays_where_it_is_when_the_camera_moves(material: str) -> None:
    geoms = boxes(("piece", material, (0.5, 0, 1.2), (0.5, 3, 3)))
    painter, shift_px = albedo_painter(geoms), 11
    one = painter.paint(see(geoms, heading(-2, 0, 1.2), (64, 48), 80))
    other = painter.paint(see(geoms, heading(-2, -shift_px * 2 / 80, 1.2), (64, 48), 80))
    np.testing.assert_allclose(other[:, :-shift_px], one[:, shift_px:], atol=2e-3)
    assert material == "blank" or one.std(axis=(0, 1)).max() > 1e-3


@pytest.mark.parametrize("material", PATTERNED)
def test_a_texture_goes_with_what_moves(material: str) -> None:
    geoms = boxes(("piece", material, (0.5, 0, 1.2), (0.5, 1, 1)))
    painter = albedo_painter(geoms)
    before = painter.paint(see(geoms, heading(-2, 0, 1.2), (64, 48), 50))
    moved = replace(geoms, position_world=geoms.position_world + [1.3, -0.4, 0])
    after = painter.paint(see(moved, heading(-0.7, -0.4, 1.2), (64, 48), 50), moved)
    np.testing.assert_allclose(after, before, atol=2e-3)


def test_neighbours_of_one_material_continue_each_other() -> None:
    whole = boxes(("floor", "floor", (0, 0, -0.5), (2, 2, 0.5)))
    halves = boxes(("east", "floor", (1, 0, -0.5), (1, 2, 0.5)), ("west", "floor", (-1, 0, -0.5), (1, 2, 0.5)))
    T = heading(-1.5, 0, 1.5, 0, 0.9)
    pictures = [albedo_painter(geoms).paint(see(geoms, T, (64, 48), 60)) for geoms in (whole, halves)]
    np.testing.assert_allclose(pictures[0], pictures[1], atol=1e-5)


def test_what_glows_shines_and_lights_its_surroundings() -> None:
    geoms = boxes(("floor", "blank", (0, 0, -0.5), (9, 9, 0.5)), ("lamp", "lamp", (0, 0, 2.5), (0.6, 0.15, 0.04)))
    surfaces = SURFACES | {"lamp": replace(SURFACES["blank"], glow=5.0)}
    painter = Painter(geoms, surfaces, 1)
    view = see(geoms, heading(-8, 0, 2, 0, 0.15), (160, 120), 140)
    radiance = painter.paint(view)[..., 1]
    floor, x = view.geom == 0, view.depth_m * (view.rays @ view.T_world_camera[0, :3, :3].T)[..., 0] - 8
    assert radiance[view.geom == 1].min() > 3 * radiance[floor].max()
    assert radiance[floor & (abs(x) < 0.5)].mean() > 1.05 * radiance[floor & (x > 5)].mean()


def test_a_corridor_has_keypoints_and_a_plain_wall_has_none() -> None:
    geoms = corridor("blank")
    for x, y, yaw in ((0, 0, 0), (0.8, 0.5, -0.9)):
        assert keypoints(geoms, see(geoms, heading(x, y, 1, yaw, 0.05))) >= 300
    bare = boxes(("left", "blank", (0, 2, 1), (9, 0.1, 9)))
    assert keypoints(bare, see(bare, heading(0, 0, 1, 1.5))) < 5


@pytest.mark.parametrize(
    ("world", "T_world_camera", "least", "most"),
    [
        ("floor4", heading(6, 1.4, 1), 300, np.inf),
        ("floor4", heading(1.2, 4.8, 1, -np.pi / 2), 300, np.inf),
        ("blank", heading(22, 1.2, 1, np.pi / 2), 0, 5),
    ],
    ids=["south corridor", "west corridor", "blank wall"],
)
def test_worlds_have_keypoints_where_they_should(
    world: str, T_world_camera: FloatArray, least: float, most: float
) -> None:
    scene = Scene(build_world(world, 1))
    view = scene.cast(PinholeCamera(640, 480, 586, 586, 319.5, 239.5), T_world_camera)
    assert least <= keypoints(scene.geoms, view, scene.surfaces) <= most


def test_what_no_ray_hit_is_black() -> None:
    geoms = facing("poster")
    view = see(geoms, heading(-3, 0, 1.2), (64, 48), 30)
    radiance = Painter(geoms, SURFACES, 1).paint(view)
    assert (view.geom < 0).any()
    assert not radiance[view.geom < 0].any()
    assert (radiance[view.geom == 0] > 0).all()


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        (replace(SURFACES["wall"], rgb=(1.2, 0, 0)), "between 0 and 1"),
        (replace(SURFACES["wall"], scale_m=0.0), "scale"),
        (replace(SURFACES["wall"], kind="marble"), "unknown kind"),  # type: ignore[arg-type]  # there is no such kind
        (replace(SURFACES["wall"], glow=-1.0), "glows"),
    ],
)
def test_impossible_surfaces_are_refused(surface: Surface, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Painter(facing("wall"), {"wall": surface}, 1)


def test_a_material_without_surface_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="'piece' has the material 'gold'"):
        Painter(facing("gold"), SURFACES, 1)
