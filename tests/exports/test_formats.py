"""Trajectories, images with poses, and trees for other programs: axes and units, by known transforms and by evo."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from bag_contents import messages_in
from evo.tools import file_interface
from numpy.testing import assert_allclose
from sessions.seen_maps import step
from synthetic import make_tum_recording
from typer.testing import CliRunner, Result

from wheelsight.app.cli import app
from wheelsight.config import Config, save_config
from wheelsight.core.errors import OutputError
from wheelsight.core.geometry import FloatArray, se3
from wheelsight.core.keyframes import Keyframe, KeyframeId, KeyframeStore
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import Trajectory, write_tum
from wheelsight.io.recordings import Recording, open_recording
from wheelsight.io.ros_map import read_ros_map
from wheelsight.slam.maps import MapFolder, MapWriter
from wheelsight_export import BagParts, export_bag, exported_at
from wheelsight_export.sources import ColoredPoints, thinned

Command = Callable[..., Result]
STEP = se3.exp([0.3, -0.1, 0.05, 0.1, 0.2, 0.3])


@pytest.fixture
def export() -> Command:
    return lambda *words: CliRunner().invoke(app, ["export", *map(str, words)])


def leave_run(folder: Path, way: Trajectory, recording: Path | None = None) -> Path:
    """A folder of results as far as exports read it."""
    folder.mkdir()
    write_tum(way, folder / "trajectory.txt")
    (folder / "status.csv").write_text("stamp_s,status,reason,matches,inliers,time_ms,flags,note\n")
    path = None if recording is None else str(recording)
    (folder / "metrics.json").write_text(json.dumps({"recording": {"path": path}}))
    save_config(Config(), folder / "config.yaml")
    return folder


@pytest.fixture
def way() -> Trajectory:
    poses = [np.eye(4)]
    for _ in range(4):
        poses.append(poses[-1] @ STEP)
    return Trajectory(
        np.array([1_700_000_000.25 + 0.1 * number for number in range(5)], np.float64),
        np.array(poses, float),
        body="base",
    )


@pytest.mark.parametrize("form", ["tum", "kitti"])
def test_evo_reads_the_same_poses(export: Command, way: Trajectory, tmp_path: Path, form: str) -> None:
    out = tmp_path / "poses.txt"
    answer = export(leave_run(tmp_path / "run", way), "--format", form, "--out", out)
    assert answer.exit_code == 0, answer.output
    assert answer.stdout == f"5 poses, T_map_base: {out}\n"
    read = file_interface.read_tum_trajectory_file if form == "tum" else file_interface.read_kitti_poses_file
    found = read(str(out))
    assert_allclose(np.array(found.poses_se3), way.T_frame_body, atol=1e-8)
    if form == "tum":
        assert_allclose(found.timestamps, way.stamps_s, atol=1e-7)


def test_euroc_has_nanoseconds_and_w_first(export: Command, way: Trajectory, tmp_path: Path) -> None:
    run = leave_run(tmp_path / "run", way)
    assert export(run, "--format", "euroc").exit_code == 0
    first, *lines = (run / "trajectory_euroc.csv").read_text().splitlines()
    assert first.startswith("#timestamp [ns], p_RS_R_x [m]")
    rows = [[float(value) for value in row[1:]] for row in csv.reader(lines)]
    assert lines[0].split(",")[0] == "1700000000250000000"
    for row, T in zip(rows, way.T_frame_body, strict=True):
        x, y, z, w, qx, qy, qz = row
        assert_allclose(se3.from_quaternion([x, y, z], [qx, qy, qz, w]), T, atol=1e-8)


def test_the_way_as_known_at_the_end_is_what_is_exported(export: Command, way: Trajectory, tmp_path: Path) -> None:
    run = leave_run(tmp_path / "run", way)
    write_tum(way.moved(STEP), run / "trajectory_corrected.txt")
    assert export(run, "--format", "kitti", "--out", tmp_path / "k.txt").exit_code == 0
    found = file_interface.read_kitti_poses_file(str(tmp_path / "k.txt"))
    assert_allclose(np.array(found.poses_se3), STEP @ way.T_frame_body, atol=1e-8)


def test_one_of_several_odometries_goes_by_the_settings_beside_its_folder(way: Trajectory, tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=2)
    (tmp_path / "results").mkdir()
    run = leave_run(tmp_path / "results" / "joined", way, tmp_path / "room")
    (run / "config.yaml").rename(tmp_path / "results" / "config.yaml")
    assert exported_at(run).recording is not None


def test_what_cannot_be_exported_is_said_in_one_line(export: Command, way: Trajectory, tmp_path: Path) -> None:
    run = leave_run(tmp_path / "run", way)
    for words, reported in (
        (("--format", "svo"), "--format is 'svo' (one of colmap, euroc, kitti, nerfstudio, octomap, tum)"),
        (("--format", "tum", "--body", "wheel"), "--body is 'wheel' (one of base, camera)"),
        (("--format", "tum", "--body", "camera"), "is of the base, and no calibration is there"),
        (("--format", "colmap"), "is no map, and no folder of a run with one"),
        (("--format", "nerfstudio", "--body", "base"), "--body is of trajectories alone"),
        (("--format", "kitti", "--voxel", "0.1"), "--voxel is of maps alone"),
        (("--ply", "--images", "raw"), "--images is of bags alone (--bag, or no --images)"),
    ):
        answer = export(run, *words)
        assert answer.exit_code == 2
        assert reported in answer.stderr
        assert len(answer.stderr.splitlines()) == 1
    assert {path.name for path in run.iterdir()} == {"trajectory.txt", "status.csv", "metrics.json", "config.yaml"}


@pytest.fixture
def colored(tmp_path: Path) -> tuple[Path, Recording]:
    """Results with a map of three keyframes, whose images are in a recording."""
    room = tmp_path / "room"
    make_tum_recording(room, frames=10)
    recording = open_recording(room)
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)][::4]
    truth = recording.ground_truth
    assert truth is not None
    run = leave_run(tmp_path / "run", truth, room)
    camera, store = recording.calibration.cameras[0], KeyframeStore()
    writer = MapWriter(MapFolder.create(run / "map", recording.calibration), store)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    poses = truth.at([frame.stamp_s for frame in frames])
    for frame, T in zip(frames, poses, strict=True):
        grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
        store.add(Keyframe.of_images(frame.stamp_s, intrinsics, frame.depth_m, grey), T)
        writer.update(None)
    writer.add_edges([step(list(poses), number) for number in range(len(poses) - 1)])
    writer.close()
    return run, recording


def image_in(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return np.asarray(image)


def world_point(T_map_camera: FloatArray, recording: Recording, row: int) -> tuple[FloatArray, FloatArray]:
    """A pixel of the recording's frame, and where in the map what it shows lies."""
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)][::4]
    px = np.array([20.0, 30.0])
    depth_m = float(frames[row].depth_m[30, 20])
    assert depth_m > 0
    return px, se3.apply(T_map_camera, recording.calibration.cameras[0].back_project(px, depth_m)[None])[0]


def test_colmap_projects_points_of_the_map_where_the_images_show_them(
    export: Command, colored: tuple[Path, Recording], tmp_path: Path
) -> None:
    run, recording = colored
    answer = export(run, "--format", "colmap", "--out", tmp_path / "colmap")
    assert answer.exit_code == 0, answer.output
    model = tmp_path / "colmap" / "sparse" / "0"
    number, kind, width, height, *lens = (model / "cameras.txt").read_text().split()
    assert (number, kind) == ("1", "PINHOLE")
    camera = recording.calibration.cameras[0]
    assert (int(width), int(height)) == (camera.width, camera.height)
    fx, fy, cx, cy = map(float, lens)
    images = (model / "images.txt").read_text().split("\n")
    assert images[1] == ""  # no keypoints
    truth = recording.ground_truth
    assert truth is not None
    for row, line in enumerate(images[:-1:2]):
        _, w, x, y, z, tx, ty, tz, _, name = line.split()
        T_camera_map = se3.from_quaternion([float(tx), float(ty), float(tz)], [float(q) for q in (x, y, z, w)])
        px, p_map = world_point(truth.T_frame_body[4 * row], recording, row)
        seen = se3.apply(T_camera_map, p_map[None])[0]
        # COLMAP's pixels have their centres at halves
        assert_allclose(seen[:2] / seen[2] * (fx, fy) + (cx, cy), px + 0.5, atol=1e-3)
        image = image_in(tmp_path / "colmap" / "images" / name)
        frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
        assert_allclose(image[..., ::-1], frames[4 * row].color)
    assert (model / "points3D.txt").read_text() == ""  # this map has no surfels


def test_nerfstudio_has_the_axes_of_opengl_and_z_up(
    export: Command, colored: tuple[Path, Recording], tmp_path: Path
) -> None:
    run, recording = colored
    answer = export(run, "--format", "nerfstudio", "--out", tmp_path / "nerf")
    assert answer.exit_code == 0, answer.output
    document = json.loads((tmp_path / "nerf" / "transforms.json").read_text())
    truth = recording.ground_truth
    assert truth is not None
    assert len(document["frames"]) == 3
    for row, frame in enumerate(document["frames"]):
        px, p_map = world_point(truth.T_frame_body[4 * row], recording, row)
        turned = np.array([p_map[2], -p_map[0], -p_map[1]])  # of a camera's map: z was forward, -y is up
        x, y, z = se3.apply(se3.invert(np.array(frame["transform_matrix"])), turned[None])[0]
        assert z < 0  # OpenGL looks along -z, y up
        found = (frame["fl_x"] * x / -z + frame["cx"], frame["fl_y"] * -y / -z + frame["cy"])
        assert_allclose(found, px + 0.5, atol=1e-3)
        depth = image_in(tmp_path / "nerf" / frame["depth_file_path"])
        assert depth.dtype == np.uint16
        assert depth[30, 20] / 1000 == pytest.approx(-z, abs=1e-3)


def test_a_map_alone_gives_its_grey_keyframes(export: Command, kept_map: Path, tmp_path: Path) -> None:
    answer = export(kept_map, "--format", "nerfstudio", "--out", tmp_path / "nerf")
    assert answer.exit_code == 0, answer.output
    document = json.loads((tmp_path / "nerf" / "transforms.json").read_text())
    kept = MapFolder.open(kept_map)
    assert len(document["frames"]) == len(kept.store)
    for number, frame in enumerate(document["frames"]):
        # The map is that of a base: its axes stay, only the camera's are turned.
        expected = kept.store.T_map_keyframe[number] @ np.diag([1, -1, -1, 1])
        assert_allclose(frame["transform_matrix"], expected, atol=1e-12)
        image = image_in(tmp_path / "nerf" / frame["file_path"])
        assert image.shape == (frame["h"], frame["w"])
    again = export(kept_map, "--format", "nerfstudio", "--out", tmp_path / "nerf")
    assert again.exit_code == 2
    assert "is not empty" in again.stderr


@pytest.mark.parametrize(
    ("form", "index"),
    [("nerfstudio", "transforms.json"), ("colmap", "sparse/0/cameras.txt")],
    ids=["nerfstudio", "colmap"],
)
def test_an_export_that_is_ended_over_another_has_no_index(
    export: Command, kept_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, index: str
) -> None:
    """That of the earlier one would name images of both."""
    asked = (kept_map, "--format", form, "--out", tmp_path / "out")
    assert export(*asked).exit_code == 0
    assert (tmp_path / "out" / index).exists()

    def full(path: Path, data: bytes) -> None:
        raise OutputError("no space left on the disk", path=path)

    monkeypatch.setattr("wheelsight_export.reconstruction.write_bytes", full)
    assert export(*asked, "--force").exit_code == 2
    assert (tmp_path / "out" / "images" / "000000.png").exists()
    assert not (tmp_path / "out" / index).exists()


def test_a_map_in_a_bag_has_its_occupancy_and_the_way_between_keyframes(kept_map: Path, tmp_path: Path) -> None:
    report = export_bag(exported_at(kept_map), tmp_path / "map.mcap", BagParts())
    read = {one.topic: one for one in messages_in(tmp_path / "map.mcap")}
    assert all(one.is_latched for one in read.values())
    assert set(read) == set(report.topics) == {"/map", "/trajectory", "/tf_static", "/wheelsight/calibration"}
    plan, grid = read_ros_map(kept_map / "occupancy.yaml"), read["/map"].message
    assert np.array_equal(np.array(grid.data, np.int8).reshape(grid.info.height, grid.info.width), plan.occupancy)
    assert (grid.info.origin.position.x, grid.info.origin.position.y) == pytest.approx(plan.origin[:2])
    assert grid.info.resolution == pytest.approx(plan.resolution_m)
    kept = MapFolder.open(kept_map)
    assert kept.calibration.T_base_camera is not None
    T_map_base = se3.compose(kept.store.T_map_keyframe, se3.invert(kept.calibration.T_base_camera))
    poses = read["/trajectory"].message.poses
    assert [pose.pose.position.x for pose in poses] == pytest.approx(T_map_base[:, 0, 3])


def test_each_cube_gets_the_mean_of_its_points() -> None:
    p = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [-0.01, 0.0, 0.0]])
    colors = np.array([[0, 0, 0], [10, 20, 30], [255, 0, 0]], np.uint8)
    found = thinned(ColoredPoints(p, colors), 0.05)
    assert_allclose(found.p_map, [[-0.01, 0, 0], [0.02, 0.01, 0.01]], atol=1e-12)
    assert found.colors.tolist() == [[255, 0, 0], [5, 10, 15]]


def test_octomap_has_what_was_seen_as_occupied_and_what_lies_before_it_as_free(
    export: Command, kept_map: Path, tmp_path: Path
) -> None:
    octomap = pytest.importorskip("octomap", reason="octomap-python is not installed")
    answer = export(kept_map, "--format", "octomap", "--out", tmp_path / "map.bt", "--voxel", "0.1")
    assert answer.exit_code == 0, answer.output
    tree = octomap.OcTree(0.1)
    assert tree.readBinary(str(tmp_path / "map.bt").encode())
    kept = MapFolder.open(kept_map)
    T, keyframe = kept.store.T_map_keyframe[0], kept.store[KeyframeId(0)]
    fx, fy, cx, cy = keyframe.intrinsics
    v, u = np.argwhere(keyframe.depth_m > 0)[len(np.argwhere(keyframe.depth_m > 0)) // 2]
    z = float(keyframe.depth_m[v, u])
    p = np.array([(u - cx) / fx * z, (v - cy) / fy * z, z])
    seen, before = se3.apply(T, np.array([p, 0.5 * p]))
    assert tree.isNodeOccupied(tree.search(seen))
    assert not tree.isNodeOccupied(tree.search(before))


def test_without_octomap_that_is_said(
    export: Command, kept_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "octomap", None)
    answer = export(kept_map, "--format", "octomap", "--out", tmp_path / "map.bt")
    assert answer.exit_code == 2
    assert answer.stderr == "error: octomap-python is missing (pip install octomap-python)\n"
    assert not (tmp_path / "map.bt").exists()


@pytest.mark.parametrize(
    "line", ["1.0,tracking,,10,9", "nan,tracking,,10,9,3.5,,", "x,tracking,,,,,,", '1.0,"' + "a\n" * 90_000]
)
def test_a_status_that_is_none_is_refused(line: str, way: Trajectory, tmp_path: Path) -> None:
    run = leave_run(tmp_path / "run", way)
    with (run / "status.csv").open("a") as stream:
        stream.write(line)
    with pytest.raises(OutputError, match="is no status of a run"):
        list(exported_at(run).status())


@pytest.mark.parametrize("path", [5, ["a"], "a\0b"])
def test_a_recording_that_is_no_path_is_refused(path: object, way: Trajectory, tmp_path: Path) -> None:
    run = leave_run(tmp_path / "run", way)
    (run / "metrics.json").write_text(json.dumps({"recording": {"path": path}}))
    with pytest.raises(OutputError, match="does not name the run's recording"):
        _ = exported_at(run).recording
