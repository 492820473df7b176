"""Exports for programs of reconstruction and evaluation: images with poses for COLMAP and nerfstudio, OctoMap's binary
trees, and trajectories as TUM, KITTI or EuRoC's csv.
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wheelsight.core.errors import InputError, MapError, OutputError, TrajectoryError
from wheelsight.core.files import (
    StrPath,
    atomic_write,
    check_name,
    make_output_folder,
    new_output_folder,
    output_error,
    remove_file,
    write_bytes,
    write_text,
)
from wheelsight.core.geometry import ByteArray, Float32Array, FloatArray, PinholeCamera, se3, so3
from wheelsight.core.keyframes import KeyframeId
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.runtime import needed
from wheelsight.core.trajectory import Trajectory, write_kitti, write_tum
from wheelsight.io.recordings import Recording, express_for
from wheelsight.slam.maps import MapFolder, in_largest_piece
from wheelsight_export.bag_writing import T_LINK_OPTICAL, nanoseconds
from wheelsight_export.meshes import COLOR, ply_header
from wheelsight_export.sources import ColoredPoints, Exported, points_of, thinned, upright_points

# nerfstudio


TRANSFORMS_FILE, POINTS_FILE = "transforms.json", "points.ply"
# OpenGL: x right, y up, z backward, of what OpenCV's x right, y down, z forward looks along.
_CV_TO_GL = np.diag([1.0, -1.0, -1.0, 1.0])
# Its pixels have their centres at halves, as COLMAP's; ours at whole numbers.
HALF_PX = 0.5


def export_nerfstudio(
    source: Exported, out: StrPath, voxel_m: float, force: bool, on_view: OnView = lambda done, total: None
) -> int:
    """Write transforms.json, images and depth of keyframes, and points.ply into a folder. Returns the number of images.

    Metres, z up: in the map of a robot's base, else in the rotated map of the camera. transforms.json is written last.

    Raises InputError without a readable map; OutputError where it cannot be written.
    """
    with new_output_folder(Path(out), force) as folder:
        remove_file(folder / TRANSFORMS_FILE)  # of an earlier export it would name images that change now
        views = write_views(source, folder, on_view)
        is_of_base = source.need_map().calibration.T_base_camera is not None
        turn = np.eye(4) if is_of_base else T_LINK_OPTICAL
        points = points_of(source, voxel_m)
        document: dict[str, Any] = {"frames": []}
        for view in views:
            camera = view.camera
            k1, k2, p1, p2, k3 = camera.distortion
            frame: dict[str, Any] = {
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
            frame |= {} if view.depth_name is None else {"depth_file_path": f"{DEPTHS}/{view.depth_name}"}
            document["frames"].append(frame)
        if points is not None:
            turned = ColoredPoints(upright_points(points.p_map, "base" if is_of_base else "camera"), points.colors)
            write_points(turned, folder / POINTS_FILE)
            document["ply_file_path"] = POINTS_FILE
        write_text(folder / TRANSFORMS_FILE, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return len(views)


def write_points(points: ColoredPoints, path: Path) -> None:
    """Points and colours as PLY. Raises OutputError."""
    table = np.zeros(len(points.p_map), [(axis, "<f4") for axis in "xyz"] + COLOR)
    for axis in range(3):
        table["xyz"[axis]] = points.p_map[:, axis]
        table[COLOR[axis][0]] = points.colors[:, axis]
    with atomic_write(path, "wb") as stream:
        stream.write(ply_header(table, comment="") + b"end_header\n" + table.tobytes())


MODEL = "sparse/0"
# COLMAP's value for an unknown reprojection error.
_NO_ERROR = -1


def export_colmap(
    source: Exported, out: StrPath, voxel_m: float, force: bool, on_view: OnView = lambda done, total: None
) -> int:
    """Write a model into OUT/sparse/0 and images into OUT/images. Returns the number of images.

    Metres, in the map. Points are thinned surfels; no image observes them, since they are not keypoints.

    Raises InputError without a readable map; OutputError where it cannot be written.
    """
    with new_output_folder(Path(out), force) as folder:
        remove_file(folder / MODEL / "cameras.txt")  # without it there is no model until all is written
        views = write_views(source, folder, on_view)
        model = make_output_folder(folder / MODEL, force=True)
        numbers: dict[PinholeCamera, int] = {}
        for view in views:
            numbers.setdefault(view.camera, len(numbers) + 1)
        points = points_of(source, voxel_m)
        points_text = ""
        if points is not None:
            rows = zip(points.p_map.tolist(), points.colors.tolist(), strict=True)
            points_text = "".join(
                f"{number} {x:.6f} {y:.6f} {z:.6f} {red} {green} {blue} {_NO_ERROR}\n"
                for number, ((x, y, z), (red, green, blue)) in enumerate(rows, start=1)
            )
        write_text(model / "points3D.txt", points_text)
        # Two lines an image: T_camera_map as quaternion (w first) and position; and the keypoints, an empty line
        images = ""
        for number, view in enumerate(views, start=1):
            T_camera_map = se3.invert(view.T_map_camera)
            x, y, z, w = so3.to_quaternion(T_camera_map[:3, :3]).tolist()
            pose = " ".join(f"{value:.12g}" for value in (w, x, y, z, *T_camera_map[:3, 3]))
            images += f"{number} {pose} {numbers[view.camera]} {view.name}\n\n"
        write_text(model / "images.txt", images)
        cameras = ""
        for camera, number in numbers.items():
            lens = [camera.fx, camera.fy, camera.cx + HALF_PX, camera.cy + HALF_PX]
            if camera.has_distortion:
                lens += [*camera.distortion, 0.0, 0.0, 0.0]
            values = " ".join(f"{value:.12g}" for value in lens)
            kind = "FULL_OPENCV" if camera.has_distortion else "PINHOLE"
            cameras += f"{number} {kind} {camera.width} {camera.height} {values}\n"
        write_text(model / "cameras.txt", cameras)
    return len(views)


IMAGES, DEPTHS = "images", "depths"
# Stamps come back from the map as they were; those that went through text may miss the last digits.
_SAME_S = 1e-4
_MILLIMETRES = 1000.0

OnView = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeView:
    """One image on disk.

    Attributes:
        name: of its file, below IMAGES.
        depth_name: file of its depth in millimetres, below DEPTHS, on the same pixels; None without one.
        T_map_camera: (4, 4) of the optical frame of its camera.
        camera: of the image.
    """

    name: str
    depth_name: str | None
    T_map_camera: FloatArray
    camera: PinholeCamera


def write_views(source: Exported, folder: Path, on_view: OnView) -> list[KeyframeView]:
    """Write an image of each keyframe in the map: in colour from the recording, else in grey from the map.

    Raises MapError without keyframes, OutputError, and RecordingError if the recording cannot be read on.
    """
    kept = source.need_map()
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(in_largest_piece(kept))]
    if not numbers:
        raise MapError("has no keyframes that hang together", path=kept.path, fix="drive on, and export again")
    for below in (IMAGES, DEPTHS):
        make_output_folder(folder / below, force=True)
    try:
        recording = source.recording
    except InputError:
        recording = None
    if recording is not None and recording.calibration.color is not None:
        views = list(_of_recording(kept, recording, numbers, folder, on_view))
        if len(views) == len(numbers):
            return views
    return list(_of_map(kept, numbers, folder, on_view))


def _of_recording(
    kept: MapFolder, recording: Recording, numbers: list[KeyframeId], folder: Path, on_view: OnView
) -> Iterator[KeyframeView]:
    """Colour views; none of keyframes of another drive."""
    wanted = {number: kept.contents.places[number].stamp_s for number in numbers}
    calibration = recording.calibration
    T_camera_color, camera = se3.invert(calibration.T_color_camera), calibration.cameras[0]
    found = 0
    for event in recording.events():
        if not isinstance(event, RgbdFrame):
            continue
        number = next((one for one, at_s in wanted.items() if abs(at_s - event.stamp_s) <= _SAME_S), None)
        if number is None:
            continue
        del wanted[number]
        name = f"{number:06d}.png"
        _write(folder / IMAGES / name, cv2.cvtColor(event.color, cv2.COLOR_RGB2BGR))
        if calibration.is_registered:
            _write(folder / DEPTHS / name, _millimetres(event.depth_m))
        T_map_color = kept.store.pose(number) @ T_camera_color
        yield KeyframeView(name, name if calibration.is_registered else None, T_map_color, camera)
        found += 1
        on_view(found, len(numbers))
        if not wanted:
            return


def _of_map(kept: MapFolder, numbers: list[KeyframeId], folder: Path, on_view: OnView) -> Iterator[KeyframeView]:
    """Grey views of the keyframes' ideal camera."""
    for done, number in enumerate(numbers, start=1):
        keyframe, name = kept.store[number], f"{number:06d}.png"
        grey, depth_m = keyframe.grey, keyframe.depth_m
        _write(folder / IMAGES / name, grey.astype(np.uint8))
        _write(folder / DEPTHS / name, _millimetres(depth_m))
        height, width = grey.shape
        fx, fy, cx, cy = keyframe.intrinsics.tolist()
        yield KeyframeView(name, name, kept.store.pose(number), PinholeCamera(width, height, fx, fy, cx, cy))
        on_view(done, len(numbers))


def _millimetres(depth_m: Float32Array) -> np.ndarray:
    mm = np.rint(_MILLIMETRES * depth_m)
    return np.where(mm > np.iinfo(np.uint16).max, 0, mm).astype(np.uint16)


def _write(path: Path, image: ByteArray | np.ndarray) -> None:
    written, code = cv2.imencode(".png", image)
    assert written
    write_bytes(path, code.tobytes())


# OctoMap, with its own library, octomap-python, which must be installed


def export_octomap(
    source: Exported, path: StrPath, voxel_m: float, on_keyframe: Callable[[int, int], None] = lambda done, total: None
) -> int:
    """Write the map's keyframes as an OctoMap (.bt) with cells of `voxel_m`, z up. Returns the number of keyframes.

    Rays of each depth image mark the space before a surface as free.

    Raises:
        ConfigError: octomap-python is not installed.
        InputError: there is no readable map.
        OutputError: the file cannot be written.
    """
    octomap, path = needed("octomap"), Path(path)
    check_name(path)
    kept = source.need_map()
    numbers = [KeyframeId(int(number)) for number in np.flatnonzero(in_largest_piece(kept))]
    if not numbers:
        raise MapError("has no keyframes that hang together", path=kept.path, fix="drive on, and export again")
    body = "camera" if kept.calibration.T_base_camera is None else "base"
    tree = octomap.OcTree(voxel_m)
    for done, number in enumerate(numbers, start=1):
        T_map_camera = kept.store.pose(number)
        # Points (N, 3) of a keyframe in its own frame, one a cell
        keyframe = kept.store[number]
        depth_m, (fx, fy, cx, cy) = keyframe.depth_m, keyframe.intrinsics
        v, u = np.nonzero(depth_m)
        z = depth_m[v, u].astype(float)
        p_keyframe = np.column_stack([(u - cx) / fx * z, (v - cy) / fy * z, z])
        seen = thinned(ColoredPoints(p_keyframe, np.zeros((len(p_keyframe), 3), np.uint8)), voxel_m).p_map
        p = upright_points(se3.apply(T_map_camera, seen), body)
        eye = upright_points(T_map_camera[None, :3, 3], body)[0]
        tree.insertPointCloud(np.ascontiguousarray(p), np.ascontiguousarray(eye))
        on_keyframe(done, len(numbers))
    # Whole or not at all; the library takes names alone
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        if not tree.writeBinary(os.fsencode(temporary)):
            raise OutputError("OctoMap could not write it", path=path, fix="check the folder and the room on the disk")
        temporary.replace(path)
    except OSError as error:
        raise output_error(error, path) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    return len(numbers)


# As EuRoC's data.csv of state_groundtruth_estimate0 begins, without velocities and biases, which a trajectory lacks.
_EUROC = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"


def export_trajectory(source: Exported, form: str, path: StrPath, body: str | None = None) -> Trajectory:
    """Write a run's final trajectory in one of TRAJECTORY_FORMATS. Returns the written trajectory.

    Args:
        source: a run.
        form: format of the file.
        path: of the file.
        body: "base" or "camera"; None for the body of the run. KITTI's rules ask for a camera, but its tools take any
            body.

    Raises:
        TrajectoryError: there is none.
        CalibrationError: it is of another body, and there is no transform between the two.
        OutputError: the file cannot be written.
    """
    found = source.corrected or source.trajectory
    if found is None:
        fix = "give the folder of a run: wheelsight run RECORDING --out DIR"
        raise TrajectoryError("holds no trajectory", path=source.path, fix=fix)
    if body is not None and body != found.body:
        calibration = source.calibration
        if calibration is None:
            raise TrajectoryError(f"is of the {found.body}, and no calibration is there", path=source.path)
        found = express_for(body, found, calibration)
    TRAJECTORY_FORMATS[form](found, path)
    return found


def write_euroc(trajectory: Trajectory, path: StrPath) -> None:
    """Write EuRoC's csv, atomically: nanoseconds, position, and the quaternion with w first. Raises OutputError."""
    q_wxyz = np.roll(so3.to_quaternion(trajectory.T_frame_body[:, :3, :3]), 1, axis=1)
    lines = [
        ",".join([str(nanoseconds(stamp_s)), *(f"{value:.9f}" for value in (*position, *quaternion))])
        for stamp_s, position, quaternion in zip(
            trajectory.stamps_s.tolist(), trajectory.positions_m, q_wxyz, strict=True
        )
    ]
    write_text(Path(path), _EUROC + "".join(f"{line}\n" for line in lines))


TRAJECTORY_FORMATS: dict[str, Callable[[Trajectory, StrPath], None]] = {
    "euroc": write_euroc,
    "kitti": write_kitti,
    "tum": write_tum,
}
"""How each format is written, by its name."""
