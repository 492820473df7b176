"""nerfstudio's transforms.json: images of keyframes with poses in OpenGL's axes, and the map's points to begin with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from wheelsight.exports.map_points import ColoredPoints, points_of
from wheelsight.exports.ros_axes import upright_points
from wheelsight.exports.sources import Exported
from wheelsight.exports.views import DEPTHS, IMAGES, KeyframeView, OnView, write_views
from wheelsight.files import StrPath, atomic_write, new_output_folder, remove_file, write_text
from wheelsight.geometry import FloatArray
from wheelsight.recordings.rosbag.robot_topics import T_LINK_OPTICAL

TRANSFORMS_FILE, POINTS_FILE = "transforms.json", "points.ply"
# OpenGL: x right, y up, z backward, of what OpenCV's x right, y down, z forward looks along.
_CV_TO_GL = np.diag([1.0, -1.0, -1.0, 1.0])
# Its pixels have their centres at halves, as COLMAP's; ours at whole numbers.
HALF_PX = 0.5


def export_nerfstudio(
    source: Exported, out: StrPath, voxel_m: float, force: bool, on_view: OnView = lambda done, total: None
) -> int:
    """Write transforms.json, images and depth of keyframes, and points.ply into a folder; how many images.

    Metres, z up: in the map of a robot's base, else in that of the camera, turned. transforms.json comes last.

    Raises InputError where there is no map, or it cannot be read; OutputError where it cannot be written.
    """
    with new_output_folder(Path(out), force) as folder:
        remove_file(folder / TRANSFORMS_FILE)  # of an earlier export it would name images that change now
        views = write_views(source, folder, on_view)
        is_of_base = source.need_map().calibration.T_base_camera is not None
        turn = np.eye(4) if is_of_base else T_LINK_OPTICAL
        points = points_of(source, voxel_m)
        document: dict[str, Any] = {"frames": [_frame(view, turn) for view in views]}
        if points is not None:
            turned = ColoredPoints(upright_points(points.p_map, "base" if is_of_base else "camera"), points.colors)
            write_points(turned, folder / POINTS_FILE)
            document["ply_file_path"] = POINTS_FILE
        write_text(folder / TRANSFORMS_FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return len(views)


def _frame(view: KeyframeView, turn: FloatArray) -> dict[str, Any]:
    camera = view.camera
    k1, k2, p1, p2, k3 = camera.distortion
    told: dict[str, Any] = {
        "file_path": f"{IMAGES}/{view.name}",
        "transform_matrix": (turn @ view.T_map_camera @ _CV_TO_GL).tolist(),
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + HALF_PX,
        "cy": camera.cy + HALF_PX,
        **{"k1": k1, "k2": k2, "k3": k3, "k4": 0.0, "p1": p1, "p2": p2},
    }
    return told | ({} if view.depth_name is None else {"depth_file_path": f"{DEPTHS}/{view.depth_name}"})


def write_points(points: ColoredPoints, path: Path) -> None:
    """Points and colours as PLY. Raises OutputError."""
    table = np.zeros(
        len(points.p_map),
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")],
    )
    for axis in range(3):
        table["xyz"[axis]] = points.p_map[:, axis]
        table[("red", "green", "blue")[axis]] = points.colors[:, axis]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {color}" for color in ("red", "green", "blue")]
    with atomic_write(path, "wb") as stream:
        stream.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        stream.write(table.tobytes())
