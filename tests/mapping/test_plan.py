"""A map from above: what is where on the page, what hides what, what is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wheelsight.core.geometry import FloatArray, se3, so3
from wheelsight.mapping import Surfels
from wheelsight.mapping.plan import MapPlan, plan_of

UP, RIGHT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
NOWHERE = np.empty((0, 3))
RED, GREEN, BLUE = [200.0, 0, 0], [0, 200.0, 0], [0, 0, 200.0]


def sheet(z: float, color: list[float], x: tuple[float, float], y: tuple[float, float], normal: FloatArray) -> Surfels:
    """A level rectangle, a surfel each 2 cm."""
    u, v = np.meshgrid(np.arange(*x, 0.02), np.arange(*y, 0.02))
    position = np.stack([u.ravel(), v.ravel(), np.full(u.size, z)], axis=-1).astype(np.float32)
    n: int = len(position)
    flat = np.ones(n, np.float32)
    colors, normals = np.tile(np.array(color, np.float32), (n, 1)), np.tile(np.array(normal, np.float32), (n, 1))
    seen = (np.zeros(n), np.zeros(n), np.full(n, -1, np.int32))
    return Surfels(position, normals, 0.02 * flat, colors, 90 * flat, 9 * flat, 1e-6 * flat, *seen)


def joined(*parts: Surfels) -> Surfels:
    return Surfels(*(np.concatenate([getattr(part, name) for part in parts]) for name in Surfels.__slots__))


FLOOR = sheet(0.0, GREEN, (-2.0, 2.0), (-1.0, 1.0), UP)
TABLE = sheet(0.7, RED, (0.5, 1.0), (-0.3, 0.3), UP)
CEILING = sheet(2.5, BLUE, (-2.0, 2.0), (-1.0, 1.0), -UP)
CUPBOARD_TOP = sheet(2.0, BLUE, (-2.0, -1.5), (-1.0, 1.0), UP)
ROOM = joined(CEILING, TABLE, FLOOR, CUPBOARD_TOP)


def pieces_of(surfels: Surfels) -> list[Surfels]:
    """The first of them, and the others."""
    cuts = (slice(0, 700), slice(700, None))
    return [Surfels(*(getattr(surfels, name)[cut] for name in Surfels.__slots__)) for cut in cuts]


def color_at(plan: MapPlan, *p_map: float) -> list[int]:
    ((u, v),) = np.rint(plan.project(np.array([p_map]))).astype(int)
    return plan.image[v, u].tolist()


def made(surfels: Surfels, up: FloatArray = UP, below_m: float = 1.5, **others: FloatArray) -> MapPlan:
    plan = plan_of(lambda: pieces_of(surfels), up, below_m, others.get("shown", NOWHERE), others.get("right", RIGHT))
    assert plan is not None
    return plan


def test_the_highest_surface_shows_and_ceilings_do_not():
    plan = made(ROOM)
    assert color_at(plan, 0.75, 0.0, 0.0) == [200, 0, 0]
    assert color_at(plan, -0.75, 0.5, 0.0) == [0, 200, 0]
    assert color_at(plan, -1.75, 0.0, 0.0) == [0, 200, 0]
    assert not (plan.image[plan.is_known][:, 2] > 0).any()
    assert color_at(made(ROOM, below_m=2.2), -1.75, 0.0, 0.0) == [0, 0, 200]


def test_it_is_to_scale_and_x_points_right_and_y_up():
    plan = made(ROOM)
    (left, middle, up_page) = plan.project(np.array([[-1.0, 0, 0], [0, 0, 0], [0, 1.0, 0]]))
    np.testing.assert_allclose(middle - left, [1 / plan.m_per_px, 0])
    np.testing.assert_allclose(up_page - middle, [0, -1 / plan.m_per_px])
    seen_m2 = plan.is_known.sum() * plan.m_per_px**2
    assert seen_m2 == pytest.approx(4.0 * 2.0, rel=0.04)
    assert plan.is_known.shape == plan.image.shape[:2]


def test_it_has_no_holes_and_white_is_unknown():
    plan = made(FLOOR)
    corners = np.rint(plan.project(np.array([[-1.9, 0.9, 0], [1.9, -0.9, 0]]))).astype(int)
    assert plan.is_known[corners[0, 1] : corners[1, 1], corners[0, 0] : corners[1, 0]].all()
    assert (plan.image[~plan.is_known] == 255).all()


def test_any_direction_may_be_up():
    T = se3.from_parts(so3.exp([0.4, -1.1, 0.3]), np.zeros(3))
    R = T[:3, :3]
    turned = replace(
        ROOM, position=(ROOM.position @ R.T).astype(np.float32), normal=(ROOM.normal @ R.T).astype(np.float32)
    )
    level, tilted = made(ROOM), made(turned, up=R @ UP, right=R @ RIGHT)
    assert level.image.shape == tilted.image.shape
    assert np.mean(np.abs(level.image.astype(int) - tilted.image).max(axis=2) > 3) < 0.02
    np.testing.assert_allclose(tilted.R_plan_map, R.T, atol=1e-9)


def test_upright_surfaces_are_darker():
    wall = sheet(0.0, GREEN, (-2.0, 2.0), (-1.0, 1.0), np.array([1.0, 0.0, 0.0]))
    assert 60 < color_at(made(wall), 0.0, 0.0, 0.0)[1] < 120


def test_without_colour_it_is_grey():
    plain = replace(FLOOR, color=np.full_like(FLOOR.color, -1.0))
    assert color_at(made(plain), 0.0, 0.0, 0.0) == [90, 90, 90]


def test_the_path_is_on_the_page_and_strays_do_not_make_it_larger():
    stray = sheet(0.0, GREEN, (60.0, 60.03), (0.0, 0.01), UP)
    plan = made(joined(FLOOR, stray), shown=np.array([[0.0, 5.0, 0.3]]))
    ((u, v),) = plan.project(np.array([[0.0, 5.0, 0.3]]))
    assert 0 <= u < plan.image.shape[1]
    assert 0 <= v < plan.image.shape[0]
    assert plan.image.shape[1] * plan.m_per_px < 6


def test_large_maps_are_drawn_coarser():
    large = sheet(0.0, GREEN, (0.0, 0.5), (0.0, 0.5), UP)
    far = replace(large, position=large.position + np.array([80, 0, 0], np.float32))
    plan = made(joined(large, far))
    assert max(plan.image.shape) < 1200
    assert plan.m_per_px > 0.05


def test_up_may_be_where_right_was():
    plan = made(FLOOR, up=np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(plan.R_plan_map @ plan.R_plan_map.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(plan.R_plan_map) == pytest.approx(1)


def test_nothing_to_see_gives_no_plan():
    assert plan_of(lambda: [CEILING], UP, 3.0, NOWHERE, RIGHT) is None
    assert plan_of(lambda: [FLOOR], UP, -1.0, NOWHERE, RIGHT) is None
