"""A run shown to Rerun, read back by Rerun's own reader."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from pipeline.made import frames_at, mixed_recording, wheel_recording
from stand_ins import MemoryRecording, TrueOdometry, leave_pages_bare
from synthetic import make_tum_recording, wobbling_trajectory

from wheelsight.app.run import RunRecord
from wheelsight.app.runs import run_each
from wheelsight.config import Config, load_config
from wheelsight.core.errors import ConfigError, OutputError
from wheelsight.core.geometry import se3
from wheelsight.core.robots import EventSource
from wheelsight.core.runtime import why_missing
from wheelsight.core.settings import ViewerSettings
from wheelsight.core.trajectory import Trajectory
from wheelsight.io.recordings import open_recording
from wheelsight_export import SPAWN, open_rerun, start_viewer

pytest.importorskip("rerun", reason="rerun-sdk is not installed")
from rerun.chunk import RrdReader
from viewer.shown import Shown

BY_FEATURES = load_config(overrides={"odometry": "features"})
BOTH = load_config(overrides={"odometry": "wheels,features", "fusion": "none"})


@pytest.fixture(autouse=True)
def bare_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_pages_bare(monkeypatch)


@pytest.fixture
def truth(monkeypatch: pytest.MonkeyPatch) -> Trajectory:
    TrueOdometry.truth = wobbling_trajectory(20)
    monkeypatch.setattr("wheelsight.estimation.camera_localizer.FeatureOdometry", TrueOdometry)
    return TrueOdometry.truth


def shown(
    source: EventSource, config: Config, folder: Path, settings: ViewerSettings | None = None
) -> tuple[RunRecord, ...]:
    with open_rerun(str(folder / "run.rrd"), source.calibration, config.tracks, settings) as log:
        return run_each(source, config, folder / "out", watcher=log)


def test_poses_are_those_of_the_trajectory_on_one_timeline(truth: Trajectory, tmp_path: Path) -> None:
    (record,) = shown(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path)
    found = Shown(tmp_path / "run.rrd")
    assert found.timelines == {"time"}
    start_s = found.rows["/__properties/recording"]["start_s"][0][0]
    np.testing.assert_allclose(found.times_s("/map/odom/robot") + start_s, record.estimate.stamps_s, atol=1e-6)
    np.testing.assert_allclose(found.transforms("/map/odom/robot"), record.estimate.T_frame_body, atol=1e-6)
    np.testing.assert_allclose(found.transforms("/map/odom"), np.eye(4)[None], atol=1e-7)
    assert len(found.rows["/map/odom/trail"]["LineStrips3D:strips"]) == len(record.estimate) - 1


def test_statuses_are_reported_where_they_change_and_reasons_with_them(truth: Trajectory, tmp_path: Path) -> None:
    shown(MemoryRecording(frames_at(truth, dark=(7, 8)), truth), BY_FEATURES, tmp_path)
    found = Shown(tmp_path / "run.rrd")
    reported = found.rows["/status/features"]["StateChange:state"]
    assert [state for (state,) in reported] == ["tracking", "failing", "tracking"]
    steps_s = truth.stamps_s[[0, 7, 9]] - truth.stamps_s[0]
    np.testing.assert_allclose(found.times_s("/status/features"), steps_s, atol=1e-6)
    assert found.rows["/words/features"]["TextLog:text"] == [["too few keypoints with depth"]]
    assert len(found.rows["/map/odom/robot"]["time"]) == 18


def test_images_come_as_often_as_asked_and_no_wider_than_a_limit(
    truth: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wheelsight_export.rerun_logs._IMAGE_WIDTH_PX", 16)
    period_s = float(np.diff(truth.stamps_s).mean())
    settings = ViewerSettings(image_rate_hz=0.5 / period_s)
    shown(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path, settings)
    found = Shown(tmp_path / "run.rrd")
    colours, depths = (found.rows[f"/map/odom/robot/camera/{name}"] for name in ("color", "depth"))
    assert len(colours["EncodedImage:blob"]) == len(depths["EncodedDepthImage:blob"]) == 10
    image = cv2.imdecode(np.array(colours["EncodedImage:blob"][3][0], np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (12, 16, 3)
    assert abs(image.astype(int) - 7).max() <= 2
    depth = cv2.imdecode(np.array(depths["EncodedDepthImage:blob"][3][0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert depth is not None
    assert (depth / depths["EncodedDepthImage:meter"][3][0] == 2.0).all()
    assert colours["Pinhole:resolution"] == [[[16.0, 12.0]]]
    none = ViewerSettings(image_rate_hz=0)
    (tmp_path / "none").mkdir()
    shown(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path / "none", none)
    assert "EncodedImage:blob" not in Shown(tmp_path / "none" / "run.rrd").rows["/map/odom/robot/camera/color"]


def test_of_several_the_chief_is_the_robot_and_others_have_a_trail(truth: Trajectory, tmp_path: Path) -> None:
    wheels, features = shown(mixed_recording(truth), BOTH, tmp_path)
    found = Shown(tmp_path / "run.rrd")
    np.testing.assert_allclose(found.transforms("/map/odom/robot"), features.estimate.T_frame_body, atol=1e-6)
    np.testing.assert_allclose(found.transforms("/map/others/wheels/body"), wheels.estimate.T_frame_body, atol=1e-6)
    assert found.rows["/status/wheels"]["StateChange:state"] == [["tracking"]]


def test_wheels_alone_have_no_camera(tmp_path: Path) -> None:
    (record,) = shown(wheel_recording(50), load_config(overrides={"odometry": "wheels"}), tmp_path)
    found = Shown(tmp_path / "run.rrd")
    np.testing.assert_allclose(found.transforms("/map/odom/robot"), record.estimate.T_frame_body, atol=1e-6)
    assert not any("camera" in place for place in found.rows)


@pytest.mark.slow
def test_keyframes_stand_in_the_map_with_what_they_saw(tmp_path: Path) -> None:
    make_tum_recording(tmp_path / "room", frames=8)
    small = {"surfels.stable_confidence": 3.0, "surfels.fused_way_m": 0.0}
    config = load_config(overrides={"odometry": "dense", "map": "surfels", **small})
    settings = ViewerSettings(keyframe_points=500, map_points=2000)
    shown(open_recording(tmp_path / "room"), config, tmp_path, settings)
    found = Shown(tmp_path / "run.rrd")
    places = [place for place in found.rows if place.startswith("/map/keyframes/") and place.endswith("/points")]
    assert places
    for place in places:
        (points,) = found.rows[place]["Points3D:positions"]
        assert 100 < len(points) <= 500
        T = found.transforms(place.removesuffix("/points"))[-1]
        seen = se3.apply(T, np.array(points, float))
        assert (np.array(points)[:, 2] > 0.1).all()
        assert np.isfinite(seen).all()
    (surfels,) = found.rows["/map/surfels"]["Points3D:positions"]
    assert 500 < len(surfels) <= 2000
    near = np.linalg.norm(np.array(surfels)[None] - seen[:50, None], axis=2).min(axis=1)
    assert np.median(near) < 0.2  # what a keyframe saw lies on the map


def test_what_was_shown_is_there_when_the_run_breaks_off(truth: Trajectory, tmp_path: Path) -> None:
    events = [*frames_at(truth)[:12], KeyboardInterrupt()]
    with pytest.raises(KeyboardInterrupt):
        shown(MemoryRecording(events, truth), BY_FEATURES, tmp_path)
    assert len(Shown(tmp_path / "run.rrd").rows["/map/odom/robot"]["Transform3D:translation"]) == 12


def test_it_opens_with_a_blueprint(truth: Trajectory, tmp_path: Path) -> None:
    shown(MemoryRecording(frames_at(truth), truth), BY_FEATURES, tmp_path)
    reader = RrdReader(tmp_path / "run.rrd")
    assert [entry.application_id for entry in reader.recordings()] == ["wheelsight"]
    assert [entry.application_id for entry in reader.blueprints()] == ["wheelsight"]


def test_a_file_that_cannot_be_written_is_said_before_the_run(truth: Trajectory, tmp_path: Path) -> None:
    source = MemoryRecording(frames_at(truth), truth)
    with pytest.raises(OutputError), open_rerun(str(tmp_path / "no" / "run.rrd"), source.calibration, ("features",)):
        pytest.fail("it was opened")


def test_without_rerun_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert why_missing("rerun") is not None
    calibration = MemoryRecording([]).calibration
    with pytest.raises(ConfigError, match="pip install rerun-sdk"), open_rerun("a.rrd", calibration, ("features",)):
        pytest.fail("it was opened")


# Rerun's own server without a window, in the viewer's place: it writes what it is reported.
STAND_IN = """
import json, os, pathlib, subprocess, sys
if "--port" in sys.argv:
    state = subprocess.check_output([sys.executable, "-m", "rerun", "analytics", "config"])
    pathlib.Path("reported.json").write_text(json.dumps([json.loads(state)["analytics_enabled"], sys.argv[1:]]))
    sys.argv[-1:] = ["--save", "seen.rrd"]
os.execv(sys.executable, [sys.executable, "-m", "rerun", *sys.argv[1:]])
"""


def listening() -> set[tuple[str, int]]:
    """(address in hex as the kernel has it, port) of all that listens on this machine, by Linux."""
    rows = [row.split() for name in ("tcp", "tcp6") for row in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {(row[1].split(":")[0], int(row[1].split(":")[1], 16)) for row in rows if row[3] == "0A"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:RRD file has no footer")
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux who listens")
def test_a_viewer_that_is_started_hears_all_on_loopback_alone(
    truth: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source = MemoryRecording(frames_at(truth), truth)
    address, process = start_viewer((sys.executable, "-c", STAND_IN))
    try:
        with open_rerun(address, source.calibration, ("features",)) as log:
            (record,) = run_each(source, BY_FEATURES, tmp_path / "out", watcher=log)
        analytics, options = json.loads((tmp_path / "reported.json").read_text())
        port = int(options[options.index("--port") + 1])
        assert [place for place, at in listening() if at == port] == ["0100007F"]
        assert analytics is False
        deadline_s = time.monotonic() + 20
        while time.monotonic() < deadline_s and not holds(tmp_path / "seen.rrd", len(record.estimate)):
            time.sleep(0.2)
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()
    found = Shown(tmp_path / "seen.rrd")
    np.testing.assert_allclose(found.transforms("/map/odom/robot"), record.estimate.T_frame_body, atol=1e-6)


def holds(path: Path, poses: int) -> bool:
    try:
        return len(Shown(path).rows["/map/odom/robot"]["Transform3D:translation"]) == poses
    except (OSError, ValueError):  # it is not there yet, or not whole
        return False


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("import sys; sys.exit(sys.argv[1] != 'analytics')", "did not start"),
        ("import sys; sys.exit(1)", "does not let its analytics be switched off"),
    ],
)
def test_a_viewer_that_does_not_start_is_said(code: str, said: str) -> None:
    calibration = MemoryRecording([]).calibration
    viewer = (sys.executable, "-c", code)
    with pytest.raises(ConfigError, match=said), open_rerun(SPAWN, calibration, ("wheels",), viewer=viewer):
        pytest.fail("it was opened")
