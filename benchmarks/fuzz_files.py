"""Small sound files of every format that wheelsight reads, and what reads them: the seeds of `benchmarks.fuzz`."""

from __future__ import annotations

import ctypes
import json
import os
import struct
import time
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

import cv2
import numpy as np

from benchmarks.fuzz_recordings import (
    azure_kinect,
    bag,
    mcap_folder,
    oni_file,
    packed_bag,
    packed_mcap,
    sqlite3_bag,
)
from benchmarks.fuzz_records import first_journal
from wheelsight.app.page.session import parsed, says_stop
from wheelsight.app.run import CORRECTED_FILE, MAP_FILE
from wheelsight.app.run.runs import (
    COVARIANCES_FILE,
    METRICS_FILE,
    ODOM_FILE,
    STATUS_FILE,
    TRAJECTORY_FILE,
    write_covariances,
)
from wheelsight.config import Config, load_config, save_config
from wheelsight.core.areas import Area, AreaMap, load_areas, save_areas
from wheelsight.core.calibration import Calibration, load_calibration, save_calibration
from wheelsight.core.calibration_parts import Wheels
from wheelsight.core.errors import DeviceError, EvaluationError, RecordingError, WheelsightError
from wheelsight.core.geometry import PinholeCamera, se3
from wheelsight.core.inputs import Kind, read_bytes
from wheelsight.core.keyframes import Keyframe, KeyframeFeatures, KeyframeId
from wheelsight.core.messages import RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.settings import LiveCameraSettings
from wheelsight.core.trajectory import Trajectory, read_kitti, read_tum, write_kitti, write_tum
from wheelsight.evaluation import evaluate
from wheelsight.io.devices.cameras import open_live_camera
from wheelsight.io.devices.wheel_source import TelemetryReader, TicksFile
from wheelsight.io.devices.wire_formats import Ack, Counts, LineDecoder, Version, encode_message
from wheelsight.io.recordings import (
    OpenOptions,
    RecordingWriter,
    camera_angular_velocities,
    find_recordings,
    matches_of,
    open_recording,
    read_matches,
)
from wheelsight.io.recordings.inspection import inspect_recording
from wheelsight.io.ros_map import read_ros_map
from wheelsight.mapping import (
    EditKind,
    MapEdit,
    MapEdits,
    NamedPose,
    NamedPoses,
    SurfelMap,
    Surfels,
    load_map,
    save_map,
)
from wheelsight.places import ForestSettings, HistogramDescriber, HistogramSettings, PlaceModel
from wheelsight.places.recognition import Recognizer
from wheelsight.slam import RelativePose
from wheelsight.slam.maps import MapFolder, driven_way, info_of, occupancy_of, rebuild, save_occupancy
from wheelsight.slam.maps.folder import OCCUPANCY_FILE
from wheelsight.slam.maps.keyframes import DepthSteps
from wheelsight_batch import BatchRow, Case, Job, Outcome, Spread, read_rows
from wheelsight_batch.batches import KeptOutcomes
from wheelsight_batch.table import csv_text, rows_of
from wheelsight_calibration.board import board_from
from wheelsight_calibration.squares import read_return_errors
from wheelsight_calibration.views import read_views
from wheelsight_export import BagParts, export_bag, exported_at
from wheelsight_papers import label_source, read_labels, train_places
from wheelsight_sim import read_manual_velocities

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
_FRAMES_PLAYED = 2000
_POSE = "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
_INTRINSICS = b"14 0 7.5\n0 14 5.5\n0 0 1\n"
_ROS_MAP = (
    b"image: a.pgm\nresolution: 0.05\norigin: [-1.5, 2, 0.5]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


@dataclass(frozen=True, slots=True)
class Target:
    """A reader and a folder of sound files that it takes.

    Attributes:
        name: of the reader.
        make: makes the files, by their paths in the folder.
        read: given the folder, reads all there is.
    """

    name: str
    make: Callable[[], Files]
    read: Callable[[Path], object]

    def files(self) -> Files:
        """By their paths in the folder; made once."""
        return _made(self.make)


@cache
def _made(make: Callable[[], Files]) -> Files:
    return make()


def targets() -> list[Target]:
    """Every reader; its sound files are made when they are asked for."""
    return [*_folders(), *_bags(), *_single_files(), *_maps(), *_others()]


def _folders() -> list[Target]:
    """Recordings in folders."""
    return [
        Target("tum", _tum_folder, _play),
        Target("associations", _associations, _play),
        Target("wheelsight", _native, _play_native),
        Target("wheels", _wheels_alone, _play),
        Target("resumed", _native, _resume),
        Target("inspection", _native, _inspect),
        Target("found-recordings", _beside_each_other, _find),
        Target("openloris", _openloris, _play),
        Target("seven_scenes", _seven_scenes, _play),
        Target("skid_steer", _skid_steer, _play),
        Target("velocities", _velocities, _play),
        Target("measurement_lines", _measured, _play),
        Target("eth3d", _eth3d, _play),
        Target("bonn", _bonn, lambda folder: _play(folder / "rgbd_bonn_a")),
        Target("icl_nuim", _icl, _play),
        Target("icl_nuim-distances", _icl_distances, _play),
        Target("replica", _replica, _play),
        Target("three_d_match", _three_d_match, lambda folder: _play(folder / "seq-01")),
        Target("redwood", _redwood, _play),
    ]


def _bags() -> list[Target]:
    """Recordings in one file or database."""
    made = {
        "rosbag1": lambda: {"a.bag": bag("a.bag", _robot())},
        "rosbag1-bz2": lambda: {"a.bag": packed_bag(_robot(), "bz2")},
        "rosbag1-lz4": lambda: {"a.bag": packed_bag(_robot(), "lz4")},
        "mcap": lambda: {"a.mcap": packed_mcap(_robot(), "NONE")},
        "mcap-zstd": lambda: {"a.mcap": bag("a.mcap", _robot())},
        "mcap-lz4": lambda: {"a.mcap": packed_mcap(_robot(), "LZ4")},
        "mcap-cut": lambda: {"a.mcap": (whole := bag("a.mcap", _robot()))[: len(whole) * 3 // 4]},
        "azure_kinect": lambda: {"a.mkv": azure_kinect()},
        "scannet": lambda: {"a.sens": _sens(_images())},
    }
    folders = {
        "sqlite3": lambda: sqlite3_bag(_robot()),
        "sqlite3-messages": lambda: sqlite3_bag(_robot(), "message"),
        "sqlite3-file": lambda: sqlite3_bag(_robot(), "file"),
        "mcap-folder": lambda: mcap_folder(_robot()),
    }
    targets = [Target(name, make, _play_only_file) for name, make in made.items()]
    return [*targets, *(Target(name, make, _play) for name, make in folders.items()), *_oni()]


def _oni() -> list[Target]:
    """OpenNI2's files, where its library is there."""
    try:
        ctypes.CDLL("libOpenNI2.so.0")
    except OSError:
        return []
    return [Target("oni", lambda: {"a.oni": oni_file()}, _play_oni)]


def _single_files() -> list[Target]:
    """Tables, settings, models and trajectories."""
    labels = b"from_s,to_s,area\n0,1.5,hall\n1.5,3,lift 1\n"
    squares = b"direction,x_m,y_m\ncw,0.1,0.2\nccw,0.1,-0.2\n"
    matches = b"stamp_a_s,stamp_b_s,x_m,y_m,z_m,qx,qy,qz,qw,sigma_m,sigma_rad,score\n0,3,0,0,0,0,0,0,1,0.1,0.1,0.5\n"
    files: tuple[tuple[str, str, Callable[[], bytes], Callable[[Path], object]], ...] = (
        ("calibration", "calibration.yaml", _calibration, _calibrations),
        ("areas", "areas.yaml", _areas, load_areas),
        ("config", "config.yaml", lambda: _saved(lambda path: save_config(Config(), path)), load_config),
        ("trajectory", "a.txt", _tum, _evaluate),
        ("kitti", "a.txt", _kitti, read_kitti),
        ("labels", "labels.csv", lambda: labels, _labels),
        ("labels-of-frames", "labels.csv", lambda: b"stamp_s,area\n0,hall\n1,\n", _labels),
        ("squares", "a.csv", lambda: squares, read_return_errors),
        ("drive", "a.csv", lambda: _table("stamp_s,v_m_s,yaw_rate_rad_s", 3, 0.1), read_manual_velocities),
        ("ticks", "wheels.csv", lambda: _table("stamp_s,left,right", 3), lambda path: list(TicksFile(path).ticks())),
        ("matches", "loops.csv", lambda: matches, read_matches),
        ("places", "places.skops", _model, PlaceModel.load),
        ("surfels", "a.surfels", _map, load_map),
        ("recognition", "recognition.npz", _recognition, Recognizer.load),
        ("named-poses", "places.json", lambda: _map_folder()["places.json"], NamedPoses.load),
        ("map-edits", "edits.json", lambda: _map_folder()["edits.json"], MapEdits.load),
        ("batch-table", "table.csv", _batch_table, read_rows),
        ("serial-frames", "a.serial", _serial_frames, _decode),
        ("serial-text", "a.serial", _serial_text, _decode),
        ("serial-pairs", "a.serial", lambda: bytes(range(1, 90)) * 3, _decode),
        ("telemetry", "a.json", _telemetry, _hear),
        ("page-messages", "a.json", lambda: _MESSAGE, _page_message),
    )
    return [Target(name, _named(file, make), _reads(file, read)) for name, file, make, read in files]


def _maps() -> list[Target]:
    """Map folders, and maps of ROS."""
    return [
        Target("ros-map", lambda: {"a.yaml": _ROS_MAP, "a.pgm": _plan()}, _reads("a.yaml", read_ros_map)),
        Target("map", _map_folder, _read_map),
        Target("map-of-old", _old_map_folder, _read_map),
        Target("map-extended", _map_folder, _extend_map),
        Target("map-rebuilt", _map_folder, _rebuild_map),
    ]


def _others() -> list[Target]:
    """What runs leave, and images of a board."""
    return [
        Target("results", _results, _read_results),
        Target("batch-jobs", _batch_jobs, _read_batch_jobs),
        Target("board-views", _board_views, _read_board_views),
    ]


def _tum_folder() -> Files:
    return _images() | _lists() | {"calibration.yaml": _calibration(), "groundtruth.txt": _tum()}


def _associations() -> Files:
    pairs = b"".join(b"%d.0 rgb/%d.png %d.0 depth/%d.png\n" % (i, i, i, i) for i in range(_FRAMES))
    return {**_tum_folder(), "associations.txt": pairs}


def _native() -> Files:
    wheels = {"wheels.csv": _table("stamp_s,left,right", 3), "gyro.csv": _table("stamp_s,yaw_rate_rad_s", 2)}
    wheels |= {"imu.csv": _table("stamp_s,x_rad_s,y_rad_s,z_rad_s", 4, 0.01), "labels.csv": b"stamp_s,area\n0,hall\n"}
    matches = b"stamp_a_s,stamp_b_s,score\n0,3,0.5\n"
    return {**_tum_folder(), **wheels, "groundtruth_base.txt": _tum(), "loops.csv": matches}


def _wheels_alone() -> Files:
    return {name: data for name, data in _native().items() if "/" not in name and name not in ("rgb.txt", "depth.txt")}


def _beside_each_other() -> Files:
    """Recordings of some formats in folders and files beside each other, as on somebody's disk."""
    found = {f"a/{name}": data for name, data in _wheels_alone().items()}
    found |= {f"b/c/{name}": data for name, data in _velocities().items()}
    return found | {"b/a.sens": _sens(_images()), "b/a.bag": bag("a.bag", _robot()), "d.mkv": b"\x1a\x45\xdf\xa3"}


def _openloris() -> Files:
    lists, truth = _lists(), _tum()
    color = {"color.txt": lists["rgb.txt"], "aligned_depth.txt": lists["depth.txt"]}
    robot = {"sensors.yaml": _SENSORS.encode(), "trans_matrix.yaml": _LINKS.encode()}
    return _images() | color | robot | {"odom.txt": truth, "groundtruth.txt": truth}


def _seven_scenes() -> Files:
    images = _images()
    scenes = {f"frame-{i:06d}.color.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)}
    scenes |= {f"frame-{i:06d}.depth.png": images[f"depth/{i}.png"] for i in range(_FRAMES)}
    scenes |= {f"frame-{i:06d}.pose.txt": _POSE.encode() for i in range(_FRAMES)}
    return scenes | {"camera-intrinsics.txt": _INTRINSICS, "calibration.yaml": _calibration()}


def _skid_steer() -> Files:
    skid = {"encoders.csv": _table("stamp_s,front_right,front_left,rear_right,rear_left", 5)}
    return skid | {"imu.csv": _table("stamp_s,wz_radps", 2), "reference.txt": _tum()}


def _velocities() -> Files:
    speeds = {"odometry.csv": _table("stamp_s,v_mps,w_radps", 3)}
    return speeds | {"ground_truth.csv": _table("stamp_s,x_m,y_m,yaw_rad,valid", 5)}


def _measured() -> Files:
    measured = {"a_Input.txt": b"odom2 0.0 0.1 0 0.1 1 0 1\nodom2 1.0 0.1 0 0 1 0 1\nloop 0 1 2\n"}
    truth = b"point2 0.0 1 1 1 0 0 1\nangle 0.0 0.5 1\npoint2 1.0 2 1 1 0 0 1\nangle 1.0 0.5 1\n"
    return measured | {"a_GT.txt": truth}


def _eth3d() -> Files:
    truth = b"0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n"
    return _images() | _lists() | {"calibration.txt": b"14 14 7.5 5.5\n", "groundtruth.txt": truth}


def _bonn() -> Files:
    files = {**_eth3d(), "calibration.yaml": _calibration()}
    return {f"rgbd_bonn_a/{name}": data for name, data in files.items()}


def _icl() -> Files:
    truth = b"".join(b"%d 0 0 0 0 0 0 1\n" % i for i in range(_FRAMES))
    return _images() | {"calibration.yaml": _calibration(), "traj0.gt.freiburg": truth}


def _icl_distances() -> Files:
    images = _images()
    rendered = {f"scene_00_{i:04d}.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)}
    rendered |= {f"scene_00_{i:04d}.depth": b"1.5 " * (_CAMERA.width * _CAMERA.height) for i in range(_FRAMES)}
    return rendered | {"calibration.yaml": _calibration()}


def _replica() -> Files:
    images = _images()
    files = {f"results/frame{i:06d}.png": images[f"rgb/{i}.png"] for i in range(_FRAMES)}
    files |= {f"results/depth{i:06d}.png": images[f"depth/{i}.png"] for i in range(_FRAMES)}
    camera = {"w": _CAMERA.width, "h": _CAMERA.height, "fx": 14, "fy": 14, "cx": 7.5, "cy": 5.5, "scale": 5000}
    files |= {"cam_params.json": json.dumps({"camera": camera}).encode()}
    return files | {"traj.txt": (_POSE.replace("\n", " ") + "\n").encode() * _FRAMES}


def _three_d_match() -> Files:
    images, kinds = _images(), (("color", "rgb"), ("depth", "depth"))
    match = {f"seq-01/frame-{i:06d}.{a}.png": images[f"{b}/{i}.png"] for i in range(_FRAMES) for a, b in kinds}
    return match | {"camera-intrinsics.txt": _INTRINSICS}


def _redwood() -> Files:
    log = "".join(f"{i} {i} {i + 1}\n{_POSE}" for i in range(_FRAMES))
    return _images() | {"calibration.yaml": _calibration(), "a.log": log.encode()}


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
    """Readers that do what none may: each must be found. The last two say what fits on a screen all the same."""

    def traceback(folder: Path) -> None:
        [][0]

    def memory(folder: Path) -> object:
        return b"1" * (9 << 27)

    def disk(folder: Path) -> None:
        with TemporaryDirectory() as place, (Path(place) / "a").open("wb") as stream:
            for _ in range(1200):
                stream.write(bytes(1 << 20))
            stream.flush()
            time.sleep(0.5)

    def hang(folder: Path) -> None:
        time.sleep(60)

    def crash(folder: Path) -> None:
        ctypes.string_at(0)

    def end(folder: Path) -> None:
        os._exit(0)

    def long_message(folder: Path) -> None:
        raise RecordingError("x" * 100_000, path="y" * 5000, fix="z" * 100_000)

    def escape(folder: Path) -> None:
        raise RecordingError("\x1b[31m", path="\udcff\n")

    reads = (traceback, memory, disk, hang, crash, end, long_message, escape)
    return [Target(read.__name__, lambda: {"a.txt": b"1 2\n"}, read) for read in reads]


def _play(folder: Path) -> None:
    """All of a recording, but of one that lists very many frames the first: each takes its time, however small."""
    recording = open_recording(folder, OpenOptions())
    frames = 0
    for event in recording.events():
        frames += isinstance(event, RgbdFrame | SkippedFrame)
        if frames == _FRAMES_PLAYED:
            break
    _ = recording.ground_truth
    matches_of(recording)
    if recording.path.is_dir():
        label_source(recording)


def _play_native(folder: Path) -> None:
    _play(folder)
    camera_angular_velocities(folder)


def _play_only_file(folder: Path) -> None:
    """What is there, whatever it is called by now."""
    _play(next(iter(sorted(folder.iterdir())), folder))


def _play_oni(folder: Path) -> None:
    """For two seconds at most: it plays in the time of its own clock."""
    path = next(iter(sorted(folder.iterdir())), folder)
    with open_live_camera(f"openni2:{path}", LiveCameraSettings(width_px=320, height_px=240)) as camera:
        until_s = time.monotonic() + 2.0
        while camera.read(0.5) is not None and time.monotonic() < until_s:
            pass


def _resume(folder: Path) -> None:
    with RecordingWriter(folder, _robot(), resume=True) as writer:
        writer.add(WheelTicks(1000.0, 5, 5))


def _find(folder: Path) -> None:
    for path in find_recordings(folder):
        with suppress(WheelsightError):
            open_recording(path)


def _inspect(folder: Path) -> object:
    return inspect_recording(open_recording(folder)).to_dict()


def _named(file: str, make: Callable[[], bytes]) -> Callable[[], Files]:
    return lambda: {file: make()}


def _reads(name: str, read: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda folder: read(folder / name)


def _calibrations(path: Path) -> None:
    """Alone, and laid over another's."""
    load_calibration(path)
    load_calibration(path, under=_robot())


def _evaluate(path: Path) -> None:
    """As `wheelsight evaluate` compares it."""
    truth = _trajectory()
    with suppress(EvaluationError):
        evaluate(read_tum(path), truth)


def _labels(path: Path) -> None:
    found = read_labels(path)
    found.of_frames([0.0, 1.0, 2.0], found.names)


_SERIAL = Kind("what came over a line", most_mb=64)


def _decode(path: Path) -> None:
    """A serial line, in pieces as they come, with silences between some."""
    decoder, data = LineDecoder(), read_bytes(path, _SERIAL, DeviceError)[:200_000]
    for number, at in enumerate(range(0, len(data), 7)):
        decoder.feed(data[at : at + 7], 0.004 * number)
        if number % 5 == 0:
            decoder.feed(b"", 0.004 * number + 0.003)


def _telemetry() -> bytes:
    line = '{"ticks_stamp_s": %d.5, "left_ticks": %d, "right_ticks": 7}\n'
    return "".join(line % (i, 9 * i) for i in range(5)).encode()


def _hear(path: Path) -> None:
    """As `wheelsight run` reads the pipe of `wheelsight wheels serve`."""
    data = read_bytes(path, _SERIAL, DeviceError)
    with TemporaryDirectory() as folder:
        pipe = Path(folder) / "pipe"
        os.mkfifo(pipe)
        reader = TelemetryReader(pipe)
        writer = Thread(target=_write_into, args=(pipe, data))
        writer.start()
        try:
            for _ in reader.ticks():
                pass
        finally:
            reader.close()
            writer.join()


def _write_into(pipe: Path, data: bytes) -> None:
    with suppress(BrokenPipeError), pipe.open("wb", buffering=0) as stream:
        stream.write(data)


def _page_message(path: Path) -> None:
    text = read_bytes(path, _SERIAL, DeviceError)[:1_000_000].decode(errors="surrogateescape")
    says_stop(text)
    parsed(text)


def _read_map(folder: Path) -> object:
    """All that programs ask of a map that they do not write."""
    found = MapFolder.open(folder)
    about = info_of(found).to_dict()
    found.named_poses(), found.map_edits()
    for number in found.store:
        _ = found.store[number].features
    found.recognizer()
    found.surfels()
    driven_way(found)
    occupancy_of(found)
    read_ros_map(folder / OCCUPANCY_FILE)
    return about


def _extend_map(folder: Path) -> None:
    """A drive that goes on in the map."""
    found = MapFolder.open(folder, read_only=False)
    try:
        found.append_keyframe(len(found.store), _view(9), np.eye(4), np.eye(4))
        found.append_poses([0], np.eye(4)[None])
        found.save_recognition(found.recognizer())
        found.save_named_poses(found.named_poses().with_pose(NamedPose("door", np.array([1.0, 2.0, 0.0]))))
    finally:
        found.close()


def _rebuild_map(folder: Path) -> None:
    with TemporaryDirectory() as out:
        rebuild(MapFolder.open(folder), Path(out) / "map")


def _results() -> Files:
    """A run's folder, and its recording beside it."""

    def save(folder: Path) -> None:
        trajectory = replace(_trajectory(), covariances=np.tile(np.eye(6), (_FRAMES, 1, 1)))
        write_tum(trajectory, folder / TRAJECTORY_FILE)
        write_tum(trajectory, folder / ODOM_FILE)
        write_tum(trajectory, folder / CORRECTED_FILE)
        write_covariances(trajectory, folder / COVARIANCES_FILE)
        save_config(Config(), folder / "config.yaml")

    status = b"stamp_s,status,reason,matches,inliers,time_ms,flags,note\n"
    status += b"".join(b"%d.0,tracking,,10,9,3.5,,\n" % i for i in range(_FRAMES))
    metrics = json.dumps({"recording": {"path": "recording", "name": "a"}, "frames": {"count": _FRAMES}}).encode()
    recording = {f"recording/{name}": data for name, data in _wheels_alone().items()}
    maps = {f"map/{name}": data for name, data in _map_folder().items()}
    found = {**_saved_folder(save), STATUS_FILE: status, METRICS_FILE: metrics, MAP_FILE: _map()}
    return recording | {f"run/{name}": data for name, data in {**found, **maps}.items()}


def _read_results(folder: Path) -> None:
    """As `wheelsight export` does."""
    found = exported_at(folder / "run")
    _ = found.trajectory, found.odom, found.corrected, found.map, found.calibration, found.recording
    for _ in found.status():
        pass
    if found.surfels_file is not None:
        load_map(found.surfels_file)
    with TemporaryDirectory() as out:
        export_bag(found, Path(out) / "a.mcap", BagParts())


def _batch_table() -> bytes:
    spreads = {figure: Spread(0.1, 0.2) for figure in ("ate_m", "rpe_m", "frame_ms")}
    rows = [BatchRow(f"r{i}", "defaults", "joined", 2, "ok", "", spreads) for i in range(3)]
    return csv_text(rows).encode()


_JOBS = ("0" * 64, "1" * 64)


def _batch_jobs() -> Files:
    jobs = [Job(job, f"/recordings/{job[0]}", Config().to_dict(), 0, "c", 5) for job in _JOBS]

    def save(folder: Path) -> None:
        kept = KeptOutcomes(folder)
        for job in jobs:
            kept.keep(Outcome(job.id, figures={"ate_m": 0.1}, metrics={"a": 1}), job)

    return _saved_folder(save)


def _read_batch_jobs(folder: Path) -> None:
    found = KeptOutcomes(folder).found(_JOBS)
    csv_text(rows_of([Case("r", "defaults", "joined", (job,)) for job in found], found))


def _board_views() -> Files:
    board = np.kron(np.indices((6, 7)).sum(axis=0) % 2, np.ones((20, 20)))
    image = np.pad((255 * board).astype(np.uint8), 30, constant_values=255)
    depth = np.full(image.shape, 1000, np.uint16)
    made = {}
    for number, (suffix, of_depth) in enumerate((("png", "png"), ("bmp", "tif"), ("tif", "pgm"))):
        made[f"{number}-color.{suffix}"] = cv2.imencode(f".{suffix}", image)[1].tobytes()
        made[f"{number}-depth.{of_depth}"] = cv2.imencode(f".{of_depth}", depth)[1].tobytes()
    return made


def _read_board_views(folder: Path) -> None:
    read_views([folder], board_from("6x5:30mm"))


def _serial_frames() -> bytes:
    frames = [encode_message(Counts(i % 256, 20_000 * i, 9 * i, 8 * i)) for i in range(20)]
    return b"".join([*frames, encode_message(Version(20, 1, 1, 0, 0)), encode_message(Ack(21, 0x81, 1, 0))])


def _serial_text() -> bytes:
    return b"".join(b"%d,%d,%d\r\n" % (50 * i, 9 * i, 8 * i) for i in range(40))


_MESSAGE = b'{"type": "goal", "x_m": 1.0, "y_m": 2.5, "yaw_rad": 0.5}'


def _saved(save: Callable[[Path], object]) -> bytes:
    with TemporaryDirectory() as folder:
        save(Path(folder) / "file")
        return (Path(folder) / "file").read_bytes()


def _saved_folder(save: Callable[[Path], object]) -> Files:
    with TemporaryDirectory() as name:
        save(Path(name))
        paths = sorted(path for path in Path(name).rglob("*") if path.is_file() and path.stat().st_size)
        return {path.relative_to(name).as_posix(): path.read_bytes() for path in paths}


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


def _view(number: int) -> Keyframe:
    """A keyframe of a slope, with a few keypoints."""
    rng = np.random.default_rng(number)
    words = rng.integers(0, 2**63, (8, 4)).astype(np.uint64)
    features = KeyframeFeatures(12 * rng.random((8, 2)), 1 + rng.random((8, 3)), words)
    depth_m = 1 + np.tile(np.linspace(0, 1, 16, dtype=np.float32), (12, 1))
    grey = rng.integers(1, 255, (12, 16)).astype(np.float32)
    return Keyframe.of_images(float(number), np.array([14.0, 14.0, 7.5, 5.5]), depth_m, grey, features)


@cache
def _map_folder() -> Files:
    """A map of a few keyframes, with all that a map may have."""
    area = MapEdit(EditKind.AREA, np.array([[0, 0], [2, 0], [2, 2], [0, 2.0]]), name="hall")
    zone = MapEdit(EditKind.SPEED, np.array([[0, 0], [1, 0], [1, 1.0]]), 0.2, KeyframeId(0), np.eye(4))

    def save(path: Path) -> None:
        folder = MapFolder.create(path, _robot())
        _fill(folder)
        folder.close()
        folder = MapFolder.open(path, read_only=False)
        folder.save_recognition(folder.recognizer())
        (path / "map.surfels").write_bytes(_map())
        folder.save_edits(MapEdits((area, zone)))
        folder.save_named_poses(
            NamedPoses((NamedPose("kitchen", np.array([1.0, 0.0, 0.5]), KeyframeId(1), np.eye(4)),))
        )
        save_occupancy(folder)
        folder.close()

    return _saved_folder(save)


def _recognition() -> bytes:
    """What recognises the keyframes, with all descriptors in one file."""
    recognizer = Recognizer()
    for number in range(_FRAMES):
        recognizer.add(KeyframeId(number), _view(number))
    return _saved(recognizer.save)


def _fill(folder: MapFolder) -> None:
    for number, T in enumerate(_trajectory().T_frame_body):
        folder.append_keyframe(number, _view(number), T, T)
        if number:
            folder.append_edges([RelativePose(KeyframeId(number - 1), KeyframeId(number), T, np.eye(6))])
    folder.append_poses([1], np.eye(4)[None])
    folder.withdraw_edges([0])


def _old_map_folder() -> Files:
    """The same, its keyframes as they were kept before 2026-11-27: PNG images, in a journal of version 1."""
    steps = DepthSteps.of_noise(_robot().depth_noise)
    records = []
    for number in range(_FRAMES):
        view = _view(number)
        features = view.features
        assert features is not None
        grey = np.asarray(np.rint(view.grey / 4), np.uint8)
        images = [cv2.imencode(".png", image)[1].tobytes() for image in (steps.numbers(view.depth_m), grey)]
        places = zlib.compress(np.hstack([features.px, features.points]).astype("<f4").T.tobytes())
        sizes = len(images[0]), len(images[1]), 0, len(features.px), len(places)
        head = struct.pack("<d4ddd5i4x", view.stamp_s, *view.intrinsics, steps.step_m, steps.growth, *sizes) + b"\4"
        words = features.descriptors.astype("<u8").tobytes()
        records.append((number, b"".join([head, *images, places, words])))
    files = {name: data for name, data in _map_folder().items() if not name.startswith(("keyframes", "recognition"))}
    return {**files, "keyframes-00000.journal": first_journal(records)}


def _map() -> bytes:
    n = 5
    rng = np.random.default_rng(6)
    normal = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    flat = np.ones(n, np.float32)
    seen_s = np.zeros(n)
    position, color = rng.random((n, 3), np.float32), rng.random((n, 3), np.float32)
    made = SurfelMap()
    seen = (seen_s, seen_s, np.full(len(flat), -1, np.int32))
    made.add(Surfels(position, normal, 0.01 * flat, color, 50 * flat, flat, 1e-4 * flat, *seen), 1.0)
    return _saved(lambda path: save_map(made, path))
