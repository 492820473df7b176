from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from wheelsight.core.errors import OutputError
from wheelsight_sim.clearance import draw_plan
from wheelsight_sim.world import World
from wheelsight_sim.worlds import build_world, world_names

ROUTE_BGR, TRACK_BGR, MARK_BGR, WALL_BGR = (91, 24, 194), (192, 101, 21), (0, 0, 213), (77, 67, 61)
LEGEND_PX = 130


@pytest.fixture
def square() -> World:
    return build_world("square")


def drawn(path: Path) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture


def near(picture: np.ndarray, bgr: tuple[int, int, int]) -> np.ndarray:
    """(H, W) where the picture has about that colour."""
    return np.abs(picture.astype(int) - bgr).max(-1) < 12


@pytest.mark.parametrize("name", world_names())
def test_every_world_can_be_drawn(name: str, tmp_path: Path) -> None:
    world = build_world(name)
    draw_plan(world, tmp_path / "plan.png")
    picture = drawn(tmp_path / "plan.png")
    assert 900 < picture.shape[1] < 2500
    assert near(picture, WALL_BGR).sum() > 3000
    assert list(tmp_path.iterdir()) == [tmp_path / "plan.png"]


def test_walls_are_where_they_stand(square: World, tmp_path: Path) -> None:
    draw_plan(square, tmp_path / "plan.png", route=[(0, 0), (1, 0)], is_loop=False)
    walls = near(drawn(tmp_path / "plan.png"), WALL_BGR)
    for axis in (0, 1):
        along_px = np.flatnonzero(walls.sum(axis) > 200)  # more than letters have
        assert np.ptp(along_px) == pytest.approx(9.4 * _px_per_m(square), rel=0.01)


def test_the_route_given_is_drawn_as_far_as_it_goes(square: World, tmp_path: Path) -> None:
    def extent_px(route: list[tuple[float, float]]) -> float:
        draw_plan(square, tmp_path / "plan.png", route=route, is_loop=False)
        rows, _ = np.nonzero(near(drawn(tmp_path / "plan.png")[:-LEGEND_PX], ROUTE_BGR))
        return float(np.ptp(rows))

    shorter, longer = extent_px([(0, 0), (0, 2)]), extent_px([(0, 0), (0, 4)])
    assert longer - shorter == pytest.approx(2 * _px_per_m(square), rel=0.02)


def _px_per_m(world: World) -> float:
    """A sheet's floor is 11.5 inches wide, or, where that is less, 11.5 / 1.3 inches high; 150 dots an inch."""
    height_m = world.size_m[3] - world.size_m[1]
    return 11.5 / (1.3 * height_m) * 150


def test_a_loop_is_closed(square: World, tmp_path: Path) -> None:
    draw_plan(square, tmp_path / "closed.png")
    draw_plan(square, tmp_path / "open.png", is_loop=False)
    closed, left_open = (near(drawn(tmp_path / f"{name}.png"), ROUTE_BGR).sum() for name in ("closed", "open"))
    assert closed > 1.2 * left_open


def test_track_and_mark_are_drawn_when_given(square: World, tmp_path: Path) -> None:
    draw_plan(square, tmp_path / "bare.png")
    draw_plan(square, tmp_path / "full.png", track=np.array([(0, 0), (2, 0.5), (3, 3)]), mark=(3.0, 3.0))
    bare, full = drawn(tmp_path / "bare.png"), drawn(tmp_path / "full.png")
    for bgr in (TRACK_BGR, MARK_BGR):
        assert near(full, bgr).sum() > near(bare, bgr).sum() + 100


def test_the_same_plan_gives_the_same_bytes(square: World, tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_plan(square, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_folder_that_is_missing_is_reported(square: World, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"plan\.png"):
        draw_plan(square, tmp_path / "missing" / "plan.png")
