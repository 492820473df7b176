"""Sound files of every format that wheelsight reads, small, and what reads them: the seeds of `benchmarks.fuzz`."""

from __future__ import annotations

import json
import os
import struct
import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from benchmarks.fuzz_recordings import azure_kinect, bag, sqlite3_bag
from wheelsight.areas import Area, AreaMap, load_areas, save_areas
from wheelsight.calibration import Calibration, Wheels, load_calibration, save_calibration
from wheelsight.config import Config, load_config, save_config
from wheelsight.devices.source import TicksFile
from wheelsight.errors import RecordingError
from wheelsight.geometry import PinholeCamera, se3
from wheelsight.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.mapping import SurfelMap, Surfels, SurfelSettings, load_map, save_map
from wheelsight.odometry.wheels.squares import read_return_errors
from wheelsight.places import (
    ForestSettings,
    HistogramDescriber,
    HistogramSettings,
    PlaceModel,
    read_labels,
    train_places,
)
from wheelsight.recordings import OpenOptions, open_recording
from wheelsight.recordings.inspection import inspect_recording
from wheelsight.ros_map import read_ros_map
from wheelsight.simulation import read_manual_velocities
from wheelsight.slam import RelativePose
from wheelsight.slam.sessions import MapFolder, info_of
from wheelsight.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum

Files = Mapping[str, bytes]
_CAMERA = PinholeCamera(16, 12, 14.0, 14.0, 7.5, 5.5)
_WHEELS = Wheels(0.17, 0.17, 0.52, 3200)
_T_BASE_CAMERA = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 1.1], [0, 0, 0, 1]])
_MATRIX = "data: [ 0., 0., 1., 0.2, -1., 0., 0., 0., 0., -1., 0., 0.9, 0., 0., 0., 1. ]"
_SENSORS = """%YAML:1.0
d400_color_optical_frame:
   width: 16
   height: 12
   intrinsics: !!opencv-matrix
      rows: 1
      cols: 4
      dt: d
      data: [ 14., 7.5, 14., 5.5 ]
   distortion_coefficients: !!opencv-matrix
      rows: 1
      cols: 5
      dt: d
      data: [ 0., 0., 0., 0., 0. ]
"""
_LINKS = f"""%YAML:1.0
trans_matrix:
   -
      parent_frame: base_link
      child_frame: d400_color_optical_frame
      matrix: !!opencv-matrix
         rows: 4
         cols: 4
         dt: d
         {_MATRIX}
   -
      parent_frame: d400_color_optical_frame
      child_frame: marker
      matrix: !!opencv-matrix
         rows: 4
         cols: 4
         dt: d
         {_MATRIX}
"""
_FRAMES = 4
_ROS_MAP = (
    b"image: a.pgm\nresolution: 0.05\norigin: [-1.5, 2, 0.5]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


@dataclass(frozen=True, slots=True)
class Target:
    """A reader and a folder of sound files that it takes.

    Attributes:
        name: of the reader.
        files: by their paths in the folder.
        read: given the folder, reads all there is.
    """

    name: str
    files: Files
    read: Callable[[Path], object]


def targets() -> list[Target]:
    """Every reader with its sound files; takes a second."""
    images, lists, truth = _images(), _lists(), _tum()
    calibration = {"calibration.yaml": _calibration()}
    tum = images | lists | calibration | {"groundtruth.txt": truth}
    pairs = b"".join(b"%d.0 rgb/%d.png %d.0 depth/%d.png\n" % (i, i, i, i) for i in range(_FRAMES))
    wheels = {"wheels.csv": _table("stamp_s,left,right", 3), "gyro.csv": _table("stamp_s,yaw_rate_rad_s", 2)}
    color = {"color.txt": lists["rgb.txt"], "aligned_depth.txt": lists["depth.txt"]}
    robot = {"sensors.yaml": _SENSORS.encode(), "trans_matrix.yaml": _LINKS.encode()}
    scenes = {f"frame-{i:06d}.color.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)}
    scenes |= {f"frame-{i:06d}.depth.png": images[f"depth/{i}.png"] for i in range(_FRAMES)}
    scenes |= {f"frame-{i:06d}.pose.txt": b"1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for i in range(_FRAMES)}
    scenes |= {"camera-intrinsics.txt": b"14 0 7.5\n0 14 5.5\n0 0 1\n"} | calibration
    skid = {"encoders.csv": _table("stamp_s,front_right,front_left,rear_right,rear_left", 5)}
    skid |= {"imu.csv": _table("stamp_s,wz_radps", 2), "reference.txt": truth}
    speeds = {"odometry.csv": _table("stamp_s,v_mps,w_radps", 3)}
    speeds |= {"ground_truth.csv": _table("stamp_s,x_m,y_m,yaw_rad,valid", 5)}
    measured = {"a_Input.txt": b"odom2 0.0 0.1 0 0.1 1 0 1\nodom2 1.0 0.1 0 0 1 0 1\nloop 0 1 2\n"}
    measured |= {"a_GT.txt": b"point2 0.0 1 1 1 0 0 1\nangle 0.0 0.5 1\npoint2 1.0 2 1 1 0 0 1\nangle 1.0 0.5 1\n"}
    return [
        Target("tum", tum, _play),
        Target("associations", tum | {"associations.txt": pairs}, _play),
        Target("wheelsight", tum | wheels | {"groundtruth_base.txt": truth}, _play),
        Target("inspection", tum | wheels, _inspect),
        Target("wheels alone", wheels | calibration | {"groundtruth_base.txt": truth}, _play),
        Target("openloris", images | color | robot | {"odom.txt": truth, "groundtruth.txt": truth}, _play),
        Target("seven_scenes", scenes, _play),
        Target("skid_steer", skid, _play),
        Target("velocities", speeds, _play),
        Target("measurement_lines", measured, _play),
        *_other_formats(images, lists),
        *_single_files(),
    ]


def _other_formats(images: Files, lists: Files) -> list[Target]:
    """Formats of other people, of small images."""
    pose, numbers = "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", (("color", "rgb"), ("depth", "depth"))
    calibration = {"calibration.yaml": _calibration()}
    eth3d = {**images, **lists} | {
        "calibration.txt": b"14 14 7.5 5.5\n",
        "groundtruth.txt": b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
    }
    icl = {**images, **calibration} | {"traj0.gt.freiburg": b"".join(b"%d 0 0 0 0 0 0 1\n" % i for i in range(_FRAMES))}
    rendered = {f"scene_00_{i:04d}.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)} | calibration
    rendered |= {f"scene_00_{i:04d}.depth": b"1.5 " * (_CAMERA.width * _CAMERA.height) for i in range(_FRAMES)}
    replica = {f"results/frame{i:06d}.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)}
    replica |= {f"results/depth{i:06d}.png": images[f"depth/{i}.png"] for i in range(_FRAMES)}
    camera = {"w": _CAMERA.width, "h": _CAMERA.height, "fx": 14, "fy": 14, "cx": 7.5, "cy": 5.5, "scale": 5000}
    replica |= {"cam_params.json": json.dumps({"camera": camera}).encode()}
    replica |= {"traj.txt": (pose.replace("\n", " ") + "\n").encode() * _FRAMES}
    match = {f"seq-01/frame-{i:06d}.{a}.png": images[f"{b}/{i}.png"] for i in range(_FRAMES) for a, b in numbers}
    match |= {"camera-intrinsics.txt": b"14 0 7.5\n0 14 5.5\n0 0 1\n"}
    log = "".join(f"{i} {i} {i + 1}\n{pose}" for i in range(_FRAMES))
    return [
        Target("eth3d", eth3d, _play),
        Target("bonn", {f"rgbd_bonn_a/{name}": data for name, data in {**eth3d, **calibration}.items()}, _play_bonn),
        Target("icl_nuim", icl, _play),
        Target("icl_nuim distances", rendered, _play),
        Target("replica", replica, _play),
        Target("three_d_match", match, lambda folder: _play(folder / "seq-01")),
        Target("redwood", {**images, **calibration} | {"a.log": log.encode()}, _play),
        Target("scannet", {"a.sens": _sens(images)}, lambda folder: _play(folder / "a.sens")),
        Target("azure kinect", {"a.mkv": azure_kinect()}, lambda folder: _play(folder / "a.mkv")),
        Target("rosbag 1", {"a.bag": bag("a.bag", _robot())}, lambda folder: _play(folder / "a.bag")),
        Target("rosbag 2", {"a.mcap": bag("a.mcap", _robot())}, lambda folder: _play(folder / "a.mcap")),
        Target("rosbag 2 sqlite3", sqlite3_bag(_robot()), _play),
    ]


def _play_bonn(folder: Path) -> None:
    _play(folder / "rgbd_bonn_a")


def _sens(images: Files) -> bytes:
    """A .sens of colour as PNG and depth as zlib packs it."""
    width, height, matrix = _CAMERA.width, _CAMERA.height, struct.Struct("<16f")
    K = np.eye(4)
    K[:3, :3] = _CAMERA.K
    head = struct.pack("<IQ3s", 4, 3, b"abc") + 2 * (matrix.pack(*K.ravel()) + matrix.pack(*np.eye(4).ravel()))
    head += struct.pack("<iiIIIIfQ", 1, 1, width, height, width, height, 1000.0, _FRAMES)
    depth = zlib.compress(np.full((height, width), 1500, "<u2").tobytes())
    for i in range(_FRAMES):
        color = images[f"rgb/{i}.png"]
        head += (
            matrix.pack(*np.eye(4).ravel()) + struct.pack("<4Q", i + 1, i + 1, len(color), len(depth)) + color + depth
        )
    return head


def controls() -> list[Target]:
    """Readers that do what none may: each must be found. The last two tell what fits on a screen all the same."""

    def hang(folder: Path) -> None:
        time.sleep(60)

    def end(folder: Path) -> None:
        os._exit(3)

    def talk(folder: Path) -> None:
        raise RecordingError("x" * 100_000, path="y" * 5000, fix="z" * 100_000)

    def escape(folder: Path) -> None:
        raise RecordingError("\x1b[31m", path="\udcff\n")

    files = {"a.txt": b"1 2\n"}
    reads = {"traceback": lambda _: [][0], "memory": lambda _: b"1" * (9 << 27), "hang": hang, "end": end}
    return [Target(name, files, read) for name, read in (reads | {"talk": talk, "escape": escape}).items()]


def _single_files() -> list[Target]:
    labels = b"from_s,to_s,area\n0,1.5,hall\n1.5,3,lift 1\n"
    return [
        Target("calibration", {"calibration.yaml": _calibration()}, _reads("calibration.yaml", load_calibration)),
        Target("areas", {"areas.yaml": _areas()}, _reads("areas.yaml", load_areas)),
        Target("config", {"config.yaml": _saved(lambda path: save_config(Config(), path))}, _reads_config),
        Target("tum text", {"a.txt": _tum()}, _reads("a.txt", read_tum)),
        Target("kitti text", {"a.txt": _kitti()}, _reads("a.txt", read_kitti)),
        Target("labels", {"labels.csv": labels}, _reads("labels.csv", read_labels)),
        Target("labels of frames", {"labels.csv": b"stamp_s,area\n0,hall\n1,\n"}, _reads("labels.csv", read_labels)),
        Target("squares", {"a.csv": b"direction,x_m,y_m\ncw,0.1,0.2\nccw,0.1,-0.2\n"}, _reads("a.csv", _squares)),
        Target("drive", {"a.csv": _table("stamp_s,v_m_s,yaw_rate_rad_s", 3, 0.1)}, _reads("a.csv", _drive)),
        Target("ticks", {"wheels.csv": _table("stamp_s,left,right", 3)}, _reads("wheels.csv", _ticks)),
        Target("model", {"places.skops": _model()}, _reads("places.skops", PlaceModel.load)),
        Target("ros map", {"a.yaml": _ROS_MAP, "a.pgm": _plan()}, _reads("a.yaml", read_ros_map)),
        Target("map", {"a.surfels": _map()}, _reads("a.surfels", load_map)),
        Target("map folder", _map_folder(), _read_map_folder),
    ]


def _play(folder: Path) -> None:
    recording = open_recording(folder, OpenOptions())
    for _ in recording.events():
        pass


def _inspect(folder: Path) -> object:
    return inspect_recording(open_recording(folder)).to_dict()


def _reads(name: str, read: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: read(folder / name)


def _reads_config(folder: Path) -> object:
    return load_config(folder / "config.yaml")


def _read_map_folder(folder: Path) -> object:
    found = MapFolder.open(folder)
    for number in found.store:
        _ = found.store[number].features
    return info_of(found).to_dict()


def _squares(path: Path) -> object:
    return read_return_errors(path)


def _drive(path: Path) -> object:
    return read_manual_velocities(path)


def _ticks(path: Path) -> object:
    return list(TicksFile(path).ticks())


def _saved(save: Callable[[Path], object]) -> bytes:
    with TemporaryDirectory() as folder:
        save(Path(folder) / "file")
        return (Path(folder) / "file").read_bytes()


def _images() -> dict[str, bytes]:
    """Of a slope before a pattern, in all formats that are read."""
    rows, columns = np.mgrid[:12, :16]
    files = {}
    for i in range(_FRAMES):
        color = np.stack([20 * rows, 15 * columns, 40 * (rows % 3) + i], axis=2).astype(np.uint8)
        depth = (5000 + 100 * columns + i).astype(np.uint16)
        files[f"rgb/{i}.png"] = cv2.imencode((".png", ".bmp", ".tiff", ".jpg")[i], color)[1].tobytes()
        files[f"depth/{i}.png"] = cv2.imencode((".png", ".pgm", ".tiff", ".png")[i], depth)[1].tobytes()
    return files


def _lists() -> dict[str, bytes]:
    return {
        f"{name}.txt": b"# a list\n" + b"".join(b"%d.0 %s/%d.png\n" % (i, name.encode(), i) for i in range(_FRAMES))
        for name in ("rgb", "depth")
    }


def _table(header: str, columns: int, step: float = 1.0) -> bytes:
    lines = [",".join([f"{i}.0", *(f"{round(step * i, 3):g}" for _ in range(columns - 1))]) for i in range(_FRAMES)]
    return "\n".join([header, *lines, ""]).encode()


def _trajectory() -> Trajectory:
    T = se3.from_plane(0.1 * np.arange(_FRAMES), np.zeros(_FRAMES), 0.1 * np.arange(_FRAMES))
    return Trajectory(np.arange(_FRAMES, dtype=float), T, body="base")


def _tum() -> bytes:
    return _saved(lambda path: write_tum(_trajectory(), path))


def _kitti() -> bytes:
    return _saved(lambda path: write_kitti(_trajectory(), path))


def _robot() -> Calibration:
    return Calibration.registered_camera(_CAMERA, T_base_camera=_T_BASE_CAMERA, wheels=_WHEELS, source="a robot")


def _calibration() -> bytes:
    return _saved(lambda path: save_calibration(_robot(), path))


def _areas() -> bytes:
    rooms = [Area(f"room {i}", np.array([[i, 0], [i + 1, 0], [i + 1, 1], [i, 1.0]]), x_m=i + 0.5) for i in range(3)]
    return _saved(lambda path: save_areas(AreaMap(tuple(rooms)), path))


def _model() -> bytes:
    rng = np.random.default_rng(5)
    labels = np.repeat([0, 1, 0, 1, 0, 1], 8)
    describer = HistogramDescriber(HistogramSettings(bins=4, step_px=1))
    features = (rng.random((len(labels), describer.size)) + labels[:, None]).astype(np.float32)
    settings = ForestSettings(trees=2, folds=2, gap_frames=0, block_frames=2)
    return _saved(lambda path: train_places(features, labels, ("hall", "lift"), describer, settings).save(path))


def _plan() -> bytes:
    return cv2.imencode(".pgm", np.where(np.mgrid[:8, :9][0] % 3, 254, 0).astype(np.uint8))[1].tobytes()


def _map_folder() -> Files:
    rng = np.random.default_rng(7)
    features = KeyframeFeatures(
        rng.random((3, 2)), 1 + rng.random((3, 3)), np.arange(12, dtype=np.uint64).reshape(3, 4)
    )
    images = np.full((12, 16), 2.0, np.float32), np.full((12, 16), 90.0, np.float32)
    with TemporaryDirectory() as name:
        folder = MapFolder.create(name, Calibration.registered_camera(_CAMERA))
        for number, T in enumerate(_trajectory().T_frame_body):
            view = Keyframe.of_images(float(number), np.array([14.0, 14.0, 7.5, 5.5]), *images, features)
            folder.append_keyframe(number, view, T, T)
            if number:
                folder.append_edges([RelativePose(KeyframeId(number - 1), KeyframeId(number), T, np.eye(6))])
        folder.append_poses([1], np.eye(4)[None])
        folder.withdraw_edges([0])
        folder.close()
        return {path.name: path.read_bytes() for path in Path(name).iterdir() if path.stat().st_size}


def _map() -> bytes:
    n = 5
    rng = np.random.default_rng(6)
    normal = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    flat = np.ones(n, np.float32)
    seen_s = np.zeros(n)
    position, color = rng.random((n, 3), np.float32), rng.random((n, 3), np.float32)
    made = SurfelMap(SurfelSettings(threads=1))
    seen = (seen_s, seen_s, np.full(len(flat), -1, np.int32))
    made.add(Surfels(position, normal, 0.01 * flat, color, 50 * flat, flat, 1e-4 * flat, *seen), 1.0)
    return _saved(lambda path: save_map(made, path))
