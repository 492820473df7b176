from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mapping.scenes import Wall, look_at, made_map, pose
from typer.testing import Result

from wheelsight.mapping import load_map, save_map

Command = Callable[..., Result]
Refusal = Callable[..., str]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map's file: a slanted wall, and what was seen of another too seldom."""
    surfel_map = made_map()
    look_at(surfel_map, [Wall(1.6, slope=0.4)], [pose()] * 12)
    look_at(surfel_map, [Wall(1.6, slope=0.4)], [pose(x=0.3)], start_s=1.0)
    path = tmp_path_factory.mktemp("maps") / "map.surfels"
    save_map(surfel_map, path)
    return path


@pytest.fixture
def results(kept: Path, tmp_path: Path) -> Path:
    """A run's folder with that map."""
    (tmp_path / "results").mkdir()
    shutil.copy(kept, tmp_path / "results")
    return tmp_path / "results"


def vertices_in(path: Path) -> int:
    header = path.read_bytes().split(b"end_header")[0].decode().splitlines()
    return int(next(line for line in header if line.startswith("element vertex")).split()[2])


def test_points_go_beside_the_map_and_are_counted(wheelsight: Command, results: Path) -> None:
    answer = wheelsight("export", results, "--ply")
    assert answer.exit_code == 0, answer.output
    points, stable = results / "points.ply", load_map(results / "map.surfels").status().stable
    assert vertices_in(points) == stable
    assert answer.stdout == f"{stable:,} points, {points.stat().st_size / 1e6:.1f} MB: {points}\n"


def test_all_surfels_are_more_than_the_stable_ones(wheelsight: Command, results: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "all.ply"
    assert wheelsight("export", results, "--ply", "--all", "--out", out).exit_code == 0
    status = load_map(results / "map.surfels").status()
    assert vertices_in(out) == status.surfels > status.stable


def test_a_mesh_is_made(wheelsight: Command, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    answer = wheelsight("export", results / "map.surfels", "--mesh", "--voxel", "0.04")
    assert answer.exit_code == 0, answer.output
    assert " triangles of " in answer.stdout
    assert str(results / "mesh.ply") in answer.stdout.replace("\n", "")
    assert "meshing" in answer.stderr
    coarse = vertices_in(results / "mesh.ply")
    assert wheelsight("export", results, "--mesh", "--force").exit_code == 0
    assert vertices_in(results / "mesh.ply") > 2 * coarse
    before = vertices_in(results / "mesh.ply")
    assert wheelsight("export", results, "--mesh", "--all", "--force").exit_code == 0
    assert vertices_in(results / "mesh.ply") > before


def test_open3d_opens_both(wheelsight: Command, results: Path) -> None:
    o3d = pytest.importorskip("open3d", reason="Open3D is not installed (extra bench)")
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    assert wheelsight("export", results, "--ply").exit_code == 0
    assert wheelsight("export", results, "--mesh").exit_code == 0
    points = o3d.io.read_point_cloud(str(results / "points.ply"))
    assert len(points.points) == vertices_in(results / "points.ply")
    assert points.has_normals()
    assert points.has_colors()
    mesh = o3d.io.read_triangle_mesh(str(results / "mesh.ply"))
    assert len(mesh.triangles) > 100
    assert mesh.has_vertex_colors()
    assert np.abs(Wall(1.6, slope=0.4).distance(np.asarray(mesh.vertices))).max() < 0.02


def test_of_several_odometries_it_finds_the_one_with_a_map(wheelsight: Command, kept: Path, tmp_path: Path) -> None:
    (tmp_path / "dense").mkdir()
    shutil.copy(kept, tmp_path / "dense")
    assert wheelsight("export", tmp_path, "--ply").exit_code == 0
    assert (tmp_path / "dense" / "points.ply").is_file()


def test_what_is_missing_is_reported_with_its_fix(refusal: Refusal, results: Path, tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    fix = "(make one: wheelsight run RECORDING --odometry dense --map surfels --out DIR)"
    assert refusal("export", tmp_path / "plain", "--ply") == f"{tmp_path / 'plain'}: holds no map.surfels {fix}"
    assert refusal("export", tmp_path / "none", "--ply").endswith("there is no such folder or file (check the path)")
    assert "one of --ply, --mesh, --bag, --format is needed" in refusal("export", results)
    assert "--ply and --mesh are two files (give one of them at a time)" in refusal(
        "export", results, "--ply", "--mesh"
    )
    assert "--voxel is of meshes and bags and --format alone" in refusal("export", results, "--ply", "--voxel", "0.1")
    assert "does not end in .ply" in refusal("export", results, "--ply", "--out", tmp_path / "x.obj")


def test_what_is_no_map_is_reported(refusal: Refusal, results: Path) -> None:
    path = results / "map.surfels"
    path.write_bytes(path.read_bytes()[:-100])
    assert "it is damaged or cut short" in refusal("export", results, "--ply")
    path.write_text(json.dumps({}))
    assert "is no map" in refusal("export", path, "--mesh")
    assert not (results / "points.ply").exists()


def test_what_is_there_is_not_overwritten_unless_asked(wheelsight: Command, refusal: Refusal, results: Path) -> None:
    (results / "points.ply").write_text("mine")
    assert "is there already" in refusal("export", results, "--ply")
    assert (results / "points.ply").read_text() == "mine"
    assert wheelsight("export", results, "--ply", "--force").exit_code == 0


def test_without_scikit_image_the_fix_is_said(refusal: Refusal, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    assert refusal("export", results, "--mesh") == "scikit-image is missing (pip install scikit-image)"
    assert not (results / "mesh.ply").exists()


def test_a_map_without_stable_surfels_says_how_to_go_on(refusal: Refusal, wheelsight: Command, tmp_path: Path) -> None:
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()])
    save_map(surfel_map, tmp_path / "map.surfels")
    assert "no stable surfels to write (fuse more frames, or take all surfels)" in refusal("export", tmp_path, "--ply")
    assert wheelsight("export", tmp_path, "--ply", "--all").exit_code == 0


def test_the_map_of_joined_sensors_is_found(wheelsight: Command, kept: Path, tmp_path: Path) -> None:
    for place in ("dense", "joined"):
        (tmp_path / place).mkdir()
        shutil.copy(kept, tmp_path / place)
    assert wheelsight("export", tmp_path, "--ply").exit_code == 0
    assert (tmp_path / "joined" / "points.ply").exists()
    assert not (tmp_path / "dense" / "points.ply").exists()
