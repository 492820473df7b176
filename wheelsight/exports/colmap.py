"""COLMAP's text model: cameras.txt, images.txt and points3D.txt, beside the images of keyframes."""

from __future__ import annotations

from pathlib import Path

from wheelsight.exports.map_points import ColoredPoints, points_of
from wheelsight.exports.nerfstudio import HALF_PX
from wheelsight.exports.sources import Exported
from wheelsight.exports.views import KeyframeView, OnView, write_views
from wheelsight.files import StrPath, make_output_folder, new_output_folder, remove_file, write_text
from wheelsight.geometry import PinholeCamera, se3, so3

MODEL = "sparse/0"
# COLMAP's word for an error that nobody reckoned.
_NO_ERROR = -1


def export_colmap(
    source: Exported, out: StrPath, voxel_m: float, force: bool, on_view: OnView = lambda done, total: None
) -> int:
    """Write a model into OUT/sparse/0 and images into OUT/images; how many images.

    Metres, in the map. Points are the map's; no image observes them, for they come of surfels, not of keypoints.

    Raises InputError where there is no map, or it cannot be read; OutputError where it cannot be written.
    """
    with new_output_folder(Path(out), force) as folder:
        remove_file(folder / MODEL / "cameras.txt")  # without it there is no model until all is written
        views = write_views(source, folder, on_view)
        model = make_output_folder(folder / MODEL, force=True)
        numbers: dict[PinholeCamera, int] = {}
        for view in views:
            numbers.setdefault(view.camera, len(numbers) + 1)
        write_text(model / "points3D.txt", _points_text(points_of(source, voxel_m)))
        write_text(model / "images.txt", _images_text(views, numbers))
        write_text(model / "cameras.txt", "".join(_camera_line(camera, n) for camera, n in numbers.items()))
    return len(views)


def _camera_line(camera: PinholeCamera, number: int) -> str:
    k1, k2, p1, p2, k3 = camera.distortion
    lens = [camera.fx, camera.fy, camera.cx + HALF_PX, camera.cy + HALF_PX]
    model = "FULL_OPENCV" if camera.has_distortion else "PINHOLE"
    if camera.has_distortion:
        lens += [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    numbers = " ".join(f"{value:.12g}" for value in lens)
    return f"{number} {model} {camera.width} {camera.height} {numbers}\n"


def _images_text(views: list[KeyframeView], numbers: dict[PinholeCamera, int]) -> str:
    """Two lines an image: how the map lies in the camera, w first; and the keypoints, of which there are none."""
    text = ""
    for number, view in enumerate(views, start=1):
        T_camera_map = se3.invert(view.T_map_camera)
        x, y, z, w = so3.to_quaternion(T_camera_map[:3, :3]).tolist()
        pose = " ".join(f"{value:.12g}" for value in (w, x, y, z, *T_camera_map[:3, 3]))
        text += f"{number} {pose} {numbers[view.camera]} {view.name}\n\n"
    return text


def _points_text(points: ColoredPoints | None) -> str:
    if points is None:
        return ""
    rows = zip(points.p_map.tolist(), points.colors.tolist(), strict=True)
    return "".join(
        f"{number} {x:.6f} {y:.6f} {z:.6f} {red} {green} {blue} {_NO_ERROR}\n"
        for number, ((x, y, z), (red, green, blue)) in enumerate(rows, start=1)
    )
