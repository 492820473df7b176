"""The paper's script: its virtual camera, its pictures, its table, its errors."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from synthetic import make_tum_recording

from wheelsight.core.geometry import FloatArray, so3
from wheelsight.mapping import SurfelMap, Surfels

pytest.importorskip("matplotlib", reason="the papers' scripts need the extra 'papers'")
pytest.importorskip("mujoco", reason="this script simulates")

PARTS = ("ligocki_elastic", "_ligocki_view")
UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
RED, GREEN, FLOOR = (200.0, 30.0, 30.0), (30.0, 180.0, 30.0), (120.0, 120.0, 120.0)


@pytest.fixture(scope="module")
def parts(project_folder: Path) -> Iterator[dict[str, ModuleType]]:
    sys.path.insert(0, str(project_folder / "papers"))
    try:
        yield {name: importlib.import_module(name) for name in PARTS}
    finally:
        sys.path.remove(str(project_folder / "papers"))
        for name in PARTS:
            sys.modules.pop(name, None)


def plane(
    corner: FloatArray, along: FloatArray, across: FloatArray, normal: FloatArray, color: tuple[float, ...]
) -> list[FloatArray]:
    """Position, normal and colour of surfels every 2 cm."""
    a, b = np.meshgrid(np.arange(0, 1, 0.02 / np.linalg.norm(along)), np.arange(0, 1, 0.02 / np.linalg.norm(across)))
    position = corner + a.reshape(-1, 1) * along + b.reshape(-1, 1) * across
    return [position, np.tile(normal, (len(position), 1)), np.tile(color, (len(position), 1))]


@pytest.fixture(scope="module")
def room() -> SurfelMap:
    """A floor of 4 m × 3 m with walls of 1.5 m on two sides, which face each other, and a ceiling: all face inwards.

    The red wall stands at x = 4; the green one, at x = 0, faces it and is half as high.
    """
    x, y, z = np.eye(3)
    sides = (
        plane(0 * x, 4 * x, 3 * y, z, FLOOR),
        plane(4 * x, 3 * y, 1.5 * z, -x, RED),
        plane(0 * x, 3 * y, 0.7 * z, x, GREEN),
        plane(1.6 * z, 4 * x, 3 * y, -z, (255.0, 255.0, 0.0)),
    )
    position, normal, color = (np.concatenate(parts).astype(np.float32) for parts in zip(*sides, strict=True))
    n = len(position)
    same: dict[str, Any] = {
        name: np.full(n, value, np.float32)
        for name, value in (("radius_m", 0.02), ("confidence", 50), ("variance_m2", 1e-6))
    }
    surfel_map = SurfelMap()
    same |= {"first_s": np.zeros(n), "last_s": np.zeros(n), "keyframe": np.full(n, -1, np.int32)}
    surfel_map.add(Surfels(position, normal, color=color, grey=color.mean(axis=1), **same), 0.0)
    return surfel_map


def share_of(picture: np.ndarray, color: tuple[float, ...]) -> float:
    return float((np.abs(picture.astype(float) - color) < 3).all(axis=2).mean())


def test_all_of_a_map_is_in_the_picture_and_fills_it(parts: dict[str, ModuleType], room: SurfelMap) -> None:
    for azimuth in (0.0, 70.0, 200.0):
        view = parts["_ligocki_view"].outside(room, UP, AHEAD, azimuth, 40)
        surfels = room.surfels()
        facing = surfels.normal @ view.T_map_camera[:3, 2] < 0
        px, depth_m = view.project(surfels.position[facing].astype(float))
        inside = ((px > 0) & (px < view.size)).all(axis=1)
        assert depth_m.min() > 0
        assert inside.mean() > 0.999
        assert 0.93 < max(np.ptp(px, axis=0) / view.size) < 1.01


def test_looks_the_way_it_is_reported_and_keeps_upright(parts: dict[str, ModuleType], room: SurfelMap) -> None:
    for azimuth, down in ((0.0, 30.0), (110.0, 55.0)):
        R = parts["_ligocki_view"].outside(room, UP, AHEAD, azimuth, down).T_map_camera[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        assert np.degrees(np.arctan2(R[1, 2], R[0, 2])) == pytest.approx(azimuth)
        assert np.degrees(-np.arcsin(R[2, 2])) == pytest.approx(down)
        assert R[2, 0] == pytest.approx(0)
        assert R[2, 1] < 0


@pytest.mark.slow
def test_ceiling_and_near_walls_are_cut_away(parts: dict[str, ModuleType], room: SurfelMap) -> None:
    helper = parts["_ligocki_view"]
    towards_red, _ = helper.picture_of(room, helper.outside(room, UP, AHEAD, 0.0, 40))
    towards_green, _ = helper.picture_of(room, helper.outside(room, UP, AHEAD, 180.0, 40))
    assert share_of(towards_red, RED) > 0.1
    assert share_of(towards_red, GREEN) == 0
    assert share_of(towards_green, GREEN) > 0.05
    assert share_of(towards_green, RED) == 0
    assert share_of(towards_red, FLOOR) > 0.2
    assert share_of(towards_red, (255, 255, 0)) == 0


def test_the_side_with_more_wall_is_chosen(parts: dict[str, ModuleType], room: SurfelMap) -> None:
    view = parts["_ligocki_view"].outside(room, UP, AHEAD, None, 40)
    assert view.T_map_camera[0, 2] > 0.5


def test_points_behind_walls_are_hidden(parts: dict[str, ModuleType], room: SurfelMap) -> None:
    helper = parts["_ligocki_view"]
    view = helper.outside(room, UP, AHEAD, 0.0, 40)
    _, depth_m = helper.picture_of(room, view)
    points = np.array([[2.0, 1.5, 0.5], [2.0, 1.5, -0.5], [4.5, 1.5, 0.7], [2.0, 90.0, 0.0]])
    assert view.hides(depth_m, points).tolist() == [False, True, True, True]


def test_a_viewpoint_projects_as_it_renders_at_any_scale(parts: dict[str, ModuleType]) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = so3.exp(np.array([0.1, -0.2, 0.3])), [0.5, 0.2, -1]
    view = parts["_ligocki_view"].Viewpoint(T, np.array([500.0, 510.0, 319.5, 239.5]), (640, 480))
    p = T[:3, :3] @ [0.4, -0.3, 2.0] + T[:3, 3]
    (px,), (depth_m,) = view.project(p[None])
    np.testing.assert_allclose([*px, depth_m], [319.5 + 100, 239.5 - 76.5, 2.0])
    (finer,), _ = view.scaled(2).project(p[None])
    np.testing.assert_allclose((finer + 0.5) / 2 - 0.5, px)


@pytest.mark.slow
def test_by_default_a_real_and_a_simulated_place_leave_pictures_and_a_table(
    parts: dict[str, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    script = parts["ligocki_elastic"]
    make_tum_recording(tmp_path / script.REAL, frames=20)
    monkeypatch.setenv("WHEELSIGHT_DATA", str(tmp_path))
    out = tmp_path / "out"
    assert script.main(["--out", str(out)], replace(script.FLAT, size=(320, 240), duration_s=2.0)) == 0
    pictures = {"red_kitchen.png", "red_kitchen-loops.jpg", "flat.png", "flat-loops.jpg", "models.jpg"}
    assert {path.name for path in out.iterdir()} == pictures | {"flat", "table.md"}
    for name in ("red_kitchen.png", "red_kitchen-loops.jpg", "models.jpg"):
        image = cv2.imread(str(out / name))
        assert image is not None
        assert min(image.shape[:2]) > 600
        assert len(np.unique(image.reshape(-1, 3), axis=0)) > 1000
    rows = [line.split(" | ") for line in (out / "table.md").read_text().splitlines()[2:]]
    assert [row[0] for row in rows] == [
        "| red_kitchen",
        "| red_kitchen, loops closed",
        "| flat",
        "| flat, loops closed",
    ]
    assert all(row[1] == "20 of 20" for row in rows[:2])
    assert all(float(row[4].removesuffix(" m")) < 0.02 for row in rows[:2])
    assert "no error, rate or size is given" in capsys.readouterr().out


def test_errors_are_one_line_and_code_2(
    parts: dict[str, ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_tum_recording(tmp_path / "short", frames=2)
    for arguments, says in (
        ([str(tmp_path / "absent"), "--out", str(tmp_path / "a")], "absent"),
        ([str(tmp_path / "short"), "--out", str(tmp_path)], "is not empty"),
        ([str(tmp_path / "short"), "--out", str(tmp_path / "b")], "leaves no map"),
    ):
        assert parts["ligocki_elastic"].main(arguments) == 2
        error = capsys.readouterr().err
        assert says in error
        assert error.count("\n") == 1
