"""What rays from the camera's pixels hit: the ideal image that sensor models turn into measurements."""

from __future__ import annotations

from dataclasses import dataclass

from wheelsight.geometry import Float32Array, FloatArray, Int32Array


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One ray a pixel, through the pixel's centre; row by row at the time the shutter reads it.

    Attributes:
        depth_m: (H, W) true depth along the camera's z axis; 0 where nothing was hit.
        geom: (H, W) index of the MJCF geom that was hit, -1 where none was.
        normal_world: (H, W, 3) outward unit normals in the world; 0 where nothing was hit.
        T_world_camera: (H, 4, 4) the camera's pose as each row was read.
        rays: (H, W, 3) what a depth of 1 m adds to the camera's origin, in the camera frame (z = 1).
    """

    depth_m: Float32Array
    geom: Int32Array
    normal_world: Float32Array
    T_world_camera: FloatArray
    rays: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Outlines:
    """More rays through the pixels of a view beside which another face is seen: edges run through them.

    Attributes:
        pixels: (N, 2) their rows and columns in the view.
        samples: what each pixel's S further rays hit, in one row a pixel: (N, S) for (H, W). Poses are those of the
            pixels' rows; what was hit through the pixel's middle is in the view alone.
    """

    pixels: Int32Array
    samples: View


@dataclass(frozen=True, slots=True, eq=False)
class Geoms:
    """The geoms of a scene in the MJCF's order, as arrays that kernels can read; those of moving bodies change.

    Attributes:
        names: (G,) of the geoms.
        materials: (G,) their materials' names: keys of `World.surfaces`.
        kind: (G,) MuJoCo's geom type: plane 0, sphere 2, capsule 3, ellipsoid 4, cylinder 5, box 6.
        size_m: (G, 3) MuJoCo's sizes: half lengths of a box, radius and half length of a cylinder.
        position_world: (G, 3) centres.
        R_world_geom: (G, 3, 3) orientations.
    """

    names: tuple[str, ...]
    materials: tuple[str, ...]
    kind: Int32Array
    size_m: FloatArray
    position_world: FloatArray
    R_world_geom: FloatArray
