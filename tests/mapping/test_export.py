"""Points and triangles for other programs."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from mapping.scenes import Wall, look_at, made_map, pose

from wheelsight.core.errors import ConfigError, MapError
from wheelsight.mapping import SurfelMap
from wheelsight_export import Mesh, mesh_of, meshes, write_mesh_ply, write_ply

TYPES = {"float": "<f4", "uchar": "u1"}


def wall_map(slope: float = 0.4) -> SurfelMap:
    surfel_map = made_map()
    look_at(surfel_map, [Wall(1.6, slope=slope)], [pose()] * 40)
    return surfel_map


def read_vertices(path: Path) -> np.ndarray:
    """The vertices of a binary PLY, by its header alone."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "comment wheelsight: frame map, metres"]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    fields = [line.split()[1:] for line in lines if line.startswith("property") and "list" not in line]
    return np.frombuffer(body, [(name, TYPES[kind]) for kind, name in fields], count)


def test_points_are_written_with_all_that_was_asked_for(tmp_path):
    surfel_map = wall_map()
    count = write_ply(surfel_map, tmp_path / "points.ply")
    table, surfels = read_vertices(tmp_path / "points.ply"), surfel_map.surfels("stable")
    assert count == len(table) == len(surfels.grey)
    assert table.dtype.names == ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "confidence", "radius")
    np.testing.assert_array_equal(np.stack([table[k] for k in "xyz"], axis=1), surfels.position)
    np.testing.assert_array_equal(np.stack([table[f"n{k}"] for k in "xyz"], axis=1), surfels.normal)
    np.testing.assert_allclose(table["green"], surfels.color[:, 1], atol=0.51)
    np.testing.assert_array_equal(table["confidence"], surfels.confidence)
    np.testing.assert_array_equal(table["radius"], surfels.radius_m)


def test_open3d_reads_points_and_mesh(tmp_path):
    o3d = pytest.importorskip("open3d", reason="Open3D is not installed (extra bench)")
    surfel_map = wall_map()
    write_ply(surfel_map, tmp_path / "points.ply")
    mesh = mesh_of(surfel_map, 0.03)
    write_mesh_ply(mesh, tmp_path / "mesh.ply")
    points = o3d.io.read_point_cloud(str(tmp_path / "points.ply"))
    np.testing.assert_allclose(np.asarray(points.points), surfel_map.surfels("stable").position)
    assert points.has_normals()
    assert points.has_colors()
    triangles = o3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply"))
    np.testing.assert_allclose(np.asarray(triangles.vertices), mesh.vertices)
    np.testing.assert_array_equal(np.asarray(triangles.triangles), mesh.triangles)
    assert triangles.has_vertex_colors()
    assert triangles.is_orientable()
    assert triangles.is_edge_manifold()


@pytest.mark.parametrize("chunk", [meshes.CHUNK_VOXELS, 16], ids=["one chunk", "many chunks"])
def test_the_mesh_of_a_plane_lies_in_it(monkeypatch, chunk):
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    monkeypatch.setattr(meshes, "CHUNK_VOXELS", chunk)
    wall, surfel_map = Wall(1.6, slope=0.4), wall_map()
    mesh = mesh_of(surfel_map, 0.03)
    assert np.abs(wall.distance(mesh.vertices)).max() < 1e-3
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(float) for k in range(3))
    doubled = np.cross(b - a, c - a)
    assert (doubled @ wall.normal > 0).all(), "wound as the surface faces"
    surfels = surfel_map.surfels("stable")
    seen_m2 = np.ptp(surfels.position[:, 1]) * np.ptp(surfels.position[:, 0]) * np.hypot(1, wall.slope)
    # The wall is seen as a trapezium, and the mesh ends up to three voxels beyond it.
    assert 0.75 * seen_m2 < 0.5 * np.linalg.norm(doubled, axis=1).sum() < 1.2 * seen_m2
    assert (mesh.normals @ wall.normal > 0.999).all()


def test_chunks_meet_without_seams(monkeypatch):
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    whole = mesh_of(wall_map(), 0.03)
    monkeypatch.setattr(meshes, "CHUNK_VOXELS", 16)
    pieces = mesh_of(wall_map(), 0.03)
    assert len(pieces.triangles) == len(whole.triangles)
    assert len(pieces.vertices) == len(whole.vertices)


@pytest.mark.parametrize("voxel_m", [0.0, -1.0, np.nan, np.inf])
def test_voxels_have_a_size(voxel_m):
    with pytest.raises(MapError, match="voxel_m"):
        mesh_of(wall_map(), voxel_m)


def test_a_map_without_stable_surfels_has_nothing_to_write(tmp_path):
    surfel_map = made_map()
    look_at(surfel_map, [Wall(2.0)], [pose()])
    with pytest.raises(MapError, match="no stable surfels"):
        write_ply(surfel_map, tmp_path / "points.ply")
    with pytest.raises(MapError, match="no stable surfels"):
        mesh_of(surfel_map)
    assert not list(tmp_path.iterdir())
    assert write_ply(surfel_map, tmp_path / "points.ply", stable_only=False) == len(surfel_map)
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    assert len(mesh_of(surfel_map, 0.05, stable_only=False).triangles) > 0


def test_an_empty_map_has_nothing_to_write_at_all(tmp_path):
    with pytest.raises(MapError, match="the map has no surfels"):
        write_ply(made_map(), tmp_path / "points.ply", stable_only=False)


def test_meshing_shows_how_far_it_is(monkeypatch):
    pytest.importorskip("skimage", reason="scikit-image is not installed (extra mesh)")
    monkeypatch.setattr(meshes, "CHUNK_VOXELS", 16)
    reported: list[tuple[int, int]] = []
    mesh_of(wall_map(), 0.03, on_chunk=lambda done, total: reported.append((done, total)))
    assert [done for done, _ in reported] == sorted({done for done, _ in reported})
    assert len({total for _, total in reported}) == 1
    assert 1 < len(reported) <= reported[0][1]


def test_without_scikit_image_the_fix_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    with pytest.raises(ConfigError, match="pip install scikit-image"):
        mesh_of(wall_map())


def test_a_mesh_may_be_of_any_colors(tmp_path):
    mesh = Mesh(
        np.eye(3, dtype=np.float32),
        np.eye(3, dtype=np.float32),
        np.full((3, 3), 7, np.uint8),
        np.array([[0, 1, 2]], np.int32),
    )
    write_mesh_ply(mesh, tmp_path / "mesh.ply")
    assert (read_vertices(tmp_path / "mesh.ply")["red"] == 7).all()
    assert (tmp_path / "mesh.ply").read_bytes().endswith(b"\x03" + np.array([0, 1, 2], "<i4").tobytes())
