"""Exports of a map as PLY points and meshes.

Open3D, MeshLab and CloudCompare open the PLY files. Meshes are made by scikit-image's marching cubes (extra `mesh`),
which is small, maintained, and has a permissive licence. The Poisson reconstructions of Open3D and MeshLab close holes
with surfaces that were never seen.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wheelsight.core.errors import MapError
from wheelsight.core.files import StrPath, atomic_write
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, Int32Array
from wheelsight.core.runtime import needed
from wheelsight.mapping.plan import colors_of
from wheelsight.mapping.surfels import FRAME, SurfelMap, Surfels

_MarchingCubes = Callable[..., tuple[FloatArray, np.ndarray, np.ndarray, np.ndarray]]

_REACH_VOXELS = 3
CHUNK_VOXELS = 128
_PLY_TYPES = {"<f4": "float", "u1": "uchar", "<i4": "int"}
_POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4")]
COLOR = [("red", "u1"), ("green", "u1"), ("blue", "u1")]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangle mesh.

    Attributes:
        vertices: (v, 3) float32 in metres, in the map frame.
        normals: (v, 3) float32 of length 1.
        colors: (v, 3) uint8 red, green, blue.
        triangles: (t, 3) int32 vertex indices, counter-clockwise as seen from the viewpoint.
    """

    vertices: Float32Array
    normals: Float32Array
    colors: ByteArray
    triangles: Int32Array


def write_ply(surfel_map: SurfelMap, path: StrPath, stable_only: bool = True) -> int:
    """Write surfels as points with normals, colours, confidence and radius, atomically; return their number.

    Raises:
        MapError: there are no surfels to write.
        OutputError: the file cannot be written.
    """
    path = Path(path)
    surfels = surfel_map.surfels("stable" if stable_only else "all")
    _refuse_empty(surfels, stable_only)
    table = np.empty(len(surfels.grey), [*_POINT, *COLOR, ("confidence", "<f4"), ("radius", "<f4")])
    _fill(table, surfels.position, surfels.normal, colors_of(surfels))
    table["confidence"], table["radius"] = surfels.confidence, surfels.radius_m
    with atomic_write(path, "wb") as stream:
        stream.write(ply_header(table) + b"end_header\n")
        stream.write(table.tobytes())
    return len(table)


def write_mesh_ply(mesh: Mesh, path: StrPath) -> None:
    """Write a triangle mesh with normals and colours, atomically. Raises OutputError."""
    path = Path(path)
    table = np.empty(len(mesh.vertices), [*_POINT, *COLOR])
    _fill(table, mesh.vertices, mesh.normals, mesh.colors)
    faces = np.empty(len(mesh.triangles), [("count", "u1"), ("vertices", "<i4", 3)])
    faces["count"], faces["vertices"] = 3, mesh.triangles
    more = f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    with atomic_write(path, "wb") as stream:
        stream.write(ply_header(table) + more.encode())
        stream.write(table.tobytes())
        stream.write(faces.tobytes())


def mesh_of(
    surfel_map: SurfelMap,
    voxel_m: float = 0.02,
    stable_only: bool = True,
    on_chunk: Callable[[int, int], None] | None = None,
) -> Mesh:
    """Return the surface of a map's stable surfels, or of all, open where nothing was seen.

    It is computed in chunks, so that memory does not depend on the size of the map. Structures thinner than two voxels,
    such as both sides of a thin board, are lost.

    Args:
        surfel_map: map to mesh.
        voxel_m: voxel size, metres.
        stable_only: leave out surfels that were not seen often enough.
        on_chunk: called after each chunk with the number of finished chunks and their total.

    Raises:
        ConfigError: scikit-image is missing.
        MapError: `voxel_m` is not positive, or there are no such surfels.
    """
    from scipy.spatial import KDTree

    measure: _MarchingCubes = needed("skimage.measure").marching_cubes
    if not voxel_m > 0 or not np.isfinite(voxel_m):
        raise MapError(f"voxel_m is {voxel_m}, not a positive length")
    surfels = surfel_map.surfels("stable" if stable_only else "all")
    _refuse_empty(surfels, stable_only)
    pieces = []
    for done, total, first, inside in _chunks(surfels, voxel_m):
        piece = _triangles(surfels, first, inside, voxel_m, measure)
        pieces += [] if piece is None else [piece]
        if on_chunk is not None:
            on_chunk(done, total)
    if not pieces:
        raise MapError(f"surfels too sparse for voxels of {voxel_m} m", fix="use larger ones")
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    vertices = np.concatenate([piece[0] for piece in pieces])
    triangles = np.concatenate([piece[1] + offset for piece, offset in zip(pieces, offsets, strict=False)])
    # Duplicate vertices of neighbouring chunks are merged.
    cells = np.round(vertices / (1e-4 * voxel_m)).astype(np.int64)
    _, kept, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    joined = number.reshape(-1)[triangles].astype(np.int32)
    a, b, c = joined.T
    vertices, triangles = vertices[kept], joined[(a != b) & (b != c) & (c != a)]
    _, nearest = KDTree(surfels.position).query(vertices, workers=-1)
    return Mesh(vertices.astype(np.float32), surfels.normal[nearest], colors_of(surfels)[nearest], triangles)


def _chunks(surfels: Surfels, voxel_m: float) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Yield number, total, lowest voxel (3,), and relevant surfels of each chunk that has any."""
    voxel = np.floor(surfels.position / voxel_m).astype(np.int64)
    low, high = (voxel - _REACH_VOXELS) // CHUNK_VOXELS, (voxel + _REACH_VOXELS + 1) // CHUNK_VOXELS
    chunks = np.unique(np.concatenate([low, high]), axis=0)
    for number, chunk in enumerate(chunks, start=1):
        inside = np.flatnonzero(((low <= chunk) & (chunk <= high)).all(axis=1))
        if len(inside):
            yield number, len(chunks), chunk * CHUNK_VOXELS, inside


def _triangles(
    surfels: Surfels, first: np.ndarray, inside: np.ndarray, voxel_m: float, measure: _MarchingCubes
) -> tuple[FloatArray, np.ndarray] | None:
    """Return vertices (v, 3) in the map and triangles (t, 3) of a chunk; None if it has none.

    Chunks share their outermost voxels with the same values, so that surfaces meet.
    """
    from wheelsight.mapping import view_kernels as kernels

    size = (CHUNK_VOXELS + 1,) * 3
    distance, weight, origin = np.zeros(size), np.zeros(size), first * voxel_m
    chosen = (surfels.position[inside], surfels.normal[inside], surfels.confidence[inside])
    kernels.add_distances(*chosen, origin, voxel_m, _REACH_VOXELS, distance, weight)
    known = weight > 0
    distance[known] /= weight[known]
    if not known.any() or distance[known].min() >= 0 or distance[known].max() <= 0:
        return None
    # Cubes with eight known voxels, marked at their highest corner, as scikit-image requires.
    whole, corners = np.zeros_like(known), [(slice(0, -1), slice(1, None))] * 3
    whole[1:, 1:, 1:] = np.logical_and.reduce([known[corner] for corner in itertools.product(*corners)])
    try:
        vertices, triangles, _, _ = measure(distance, 0.0, mask=whole, gradient_direction="descent")
    except (RuntimeError, ValueError):  # scikit-image's errors if no cube has a surface
        return None
    return vertices * voxel_m + origin, triangles


def _refuse_empty(surfels: Surfels, stable_only: bool) -> None:
    if len(surfels.grey) == 0:
        which, fix = ("stable surfels", "fuse more frames, or take all surfels") if stable_only else ("surfels", None)
        raise MapError(f"the map has no {which} to write", fix=fix)


def _fill(table: np.ndarray, position: np.ndarray, normal: np.ndarray, colors: np.ndarray) -> None:
    for k in range(3):
        table["xyz"[k]], table[f"n{'xyz'[k]}"] = position[:, k], normal[:, k]
        table[COLOR[k][0]] = colors[:, k]


def ply_header(table: np.ndarray, comment: str = f"wheelsight: frame {FRAME}, metres") -> bytes:
    """Return the header of a table of vertices, without its last line."""
    lines = ["ply", "format binary_little_endian 1.0", *([f"comment {comment}"] if comment else [])]
    lines.append(f"element vertex {len(table)}")
    for name in table.dtype.names or ():
        kind = table.dtype[name].str.replace("|", "")
        lines.append(f"property {_PLY_TYPES[kind]} {name}")
    return ("\n".join(lines) + "\n").encode()
