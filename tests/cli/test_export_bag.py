"""`export --bag`: what others read in it, and that a run of it comes to the same poses."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_contents import messages_in, on_topic
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import Result
from written_bags import odometry_drive, write_bag

from wheelsight.core.geometry import se3
from wheelsight.core.messages import RgbdFrame, WheelSpeeds, WheelTicks
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import open_recording
from wheelsight_export import bag_writing as writing

Command = Callable[..., Result]
Refusal = Callable[..., str]
BOTH = pytest.mark.parametrize("suffix", [".mcap", ".bag"])


@pytest.fixture
def driven(wheelsight: Command, wheels: Path, tmp_path: Path) -> Path:
    """The results of a run by wheels."""
    assert wheelsight("run", wheels, "--odometry", "wheels", "--out", tmp_path / "out").exit_code == 0
    return tmp_path / "out"


def nanoseconds_of(stamp: Any) -> int:
    """Of ROS 2's time, or of ROS 1's."""
    return stamp.sec * 10**9 + stamp.nanosec if hasattr(stamp, "nanosec") else stamp.secs * 10**9 + stamp.nsecs


@BOTH
def test_another_reader_finds_poses_covariances_and_statuses(
    wheelsight: Command, driven: Path, tmp_path: Path, suffix: str
) -> None:
    bag = tmp_path / f"out{suffix}"
    answer = wheelsight("export", driven, "--bag", bag)
    assert answer.exit_code == 0, answer.output
    assert answer.stderr == ""
    way = read_tum(driven / "trajectory.txt")
    read = messages_in(bag)
    counts = {topic: sum(one.topic == topic for one in read) for topic in {one.topic for one in read}}
    assert counts == {
        "/odom": len(way),
        "/tf": len(way),
        "/diagnostics": 200,
        "/joint_states": 200,
        "/trajectory": 1,
        "/wheelsight/calibration": 1,
    }
    for topic, count in counts.items():
        assert f"{topic} {count:,}" in " ".join(answer.stdout.split())
    assert {one.topic for one in read if one.is_latched} == {"/trajectory", "/wheelsight/calibration"}
    received = [one.received_ns for one in read]
    assert received == sorted(received)
    check_odometry(on_topic(bag, "/odom"), driven)
    transforms = on_topic(bag, "/tf")[-1].transforms
    frames = [(one.header.frame_id, one.child_frame_id) for one in transforms]
    assert frames == [("map", "odom"), ("odom", "base_link")]
    assert transforms[1].transform.translation.x == pytest.approx(way.positions_m[-1, 0])
    poses = on_topic(bag, "/trajectory")[0].poses
    assert [pose.pose.position.y for pose in poses] == pytest.approx(way.positions_m[:, 1])
    reported = on_topic(bag, "/diagnostics")[-1].status[0]
    assert (int.from_bytes(reported.level) if isinstance(reported.level, bytes) else reported.level) == 0
    assert reported.message == "tracking"
    assert {pair.key for pair in reported.values} == {"matches", "inliers", "time_ms", "flags", "note"}


def check_odometry(odometry: list[Any], driven: Path) -> None:
    way = read_tum(driven / "trajectory.txt")
    assert [nanoseconds_of(one.header.stamp) for one in odometry] == [round(1e9 * s) for s in way.stamps_s.tolist()]
    last = odometry[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("odom", "base_link")
    at = last.pose.pose.position
    assert (at.x, at.y, at.z) == pytest.approx(way.positions_m[-1])
    q = last.pose.pose.orientation
    T = se3.from_quaternion([at.x, at.y, at.z], [q.x, q.y, q.z, q.w])
    assert_allclose(T, way.T_frame_body[-1], atol=1e-8)
    # 30 and 40 ticks of 2π · 0.17 / 3200 m in 0.02 s, 0.52 m apart
    a_tick_m = 2 * np.pi * 0.17 / 3200
    assert last.twist.twist.linear.x == pytest.approx(35 * a_tick_m / 0.02, rel=1e-6)
    assert last.twist.twist.angular.z == pytest.approx(10 * a_tick_m / 0.52 / 0.02, rel=1e-6)
    C = np.array(last.pose.covariance).reshape(6, 6)
    assert_allclose(C, C.T, atol=1e-15)
    assert 0 < C[5, 5] < 1e-2
    assert 0 < C[0, 0] < 1e-2
    # About the robot, not about where it set out: turning errors of before have moved it across.
    assert C[0, 5] != 0


@BOTH
def test_a_run_of_the_bag_by_its_wheels_comes_to_the_same_poses(
    wheelsight: Command, wheels: Path, driven: Path, tmp_path: Path, suffix: str
) -> None:
    for source in (wheels, driven):  # of results, /odom is an estimate and not taken for wheels
        bag = tmp_path / f"again{suffix}"
        assert wheelsight("export", source, "--bag", bag, "--force").exit_code == 0
        answer = wheelsight("run", bag, "--odometry", "wheels", "--out", tmp_path / "again", "--force")
        assert answer.exit_code == 0, answer.output
        found, known = read_tum(tmp_path / "again" / "trajectory.txt"), read_tum(driven / "trajectory.txt")
        assert_allclose(found.stamps_s, known.stamps_s, atol=1e-9)
        assert_allclose(found.T_frame_body, known.T_frame_body, atol=1e-7)


@BOTH
def test_counts_of_encoders_come_back_as_they_were_and_speeds_as_speeds(
    wheelsight: Command, wheels: Path, tmp_path: Path, suffix: str
) -> None:
    bag = tmp_path / f"wheels{suffix}"
    assert wheelsight("export", wheels, "--bag", bag).exit_code == 0
    known, found = (list(open_recording(path).events()) for path in (wheels, bag))
    assert all(isinstance(event, WheelTicks) for event in found)
    counts, again_counts = (
        [(event.left, event.right) for event in events if isinstance(event, WheelTicks)] for events in (known, found)
    )
    assert again_counts == counts
    assert [event.stamp_s for event in found] == pytest.approx([event.stamp_s for event in known])
    odometry = write_bag(tmp_path / f"odometry{suffix if suffix == '.bag' else ''}", odometry_drive(suffix == ".bag"))
    again = tmp_path / f"again{suffix}"
    assert wheelsight("export", odometry, "--bag", again).exit_code == 0
    reported, heard = (
        np.array([(event.left_rad_s, event.right_rad_s) for event in events if isinstance(event, WheelSpeeds)])
        for events in (open_recording(odometry).events(), open_recording(again).events())
    )
    assert len(reported) > 50
    assert_allclose(heard, reported, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("format: [", "is not YAML"),
        ("format: other", "field format is 'other'"),
        ("a" * 2_000_000, "a message of /wheelsight/calibration has 2,000,009 bytes, more than 1,048,576"),
    ],
)
def test_a_calibration_in_a_bag_that_is_none_is_refused(
    refusal: Refusal, tmp_path: Path, text: str, reported: str
) -> None:
    with writing.new_bag(tmp_path / "a.mcap") as bag:
        bag.add("/wheelsight/calibration", bag.make.text(text), 0.0, is_latched=True)
        bag.add("/joint_states", bag.make.joints(0.0, ("left_wheel", "right_wheel"), (0.0, 0.0), ()), 0.0)
    problem = refusal("info", tmp_path / "a.mcap")
    assert problem.startswith(str(tmp_path / "a.mcap"))
    assert reported in problem


@BOTH
def test_a_run_of_raw_images_comes_to_the_same_poses(
    wheelsight: Command, room: Path, tmp_path: Path, suffix: str
) -> None:
    bag = tmp_path / f"room{suffix}"
    assert wheelsight("export", room, "--bag", bag, "--images", "raw").exit_code == 0
    for source, out in ((room, "first"), (bag, "second")):
        done = wheelsight("run", source, "--odometry", "features", "--out", tmp_path / out)
        assert done.exit_code == 0, done.output
    first, second = (read_tum(tmp_path / out / "trajectory.txt") for out in ("first", "second"))
    assert len(first) > 5
    assert_array_equal(second.stamps_s, first.stamps_s)
    assert_allclose(second.T_frame_body, first.T_frame_body, atol=1e-9)


@BOTH
@pytest.mark.parametrize("images", ["raw", "png", "jpeg"])
def test_images_come_back_as_they_were_or_nearly(
    wheelsight: Command, room: Path, tmp_path: Path, suffix: str, images: str
) -> None:
    bag = tmp_path / f"room{suffix}"
    answer = wheelsight("export", room, "--bag", bag, "--images", images)
    assert answer.exit_code == 0, answer.output
    known, found = (
        [event for event in open_recording(path).events() if isinstance(event, RgbdFrame)] for path in (room, bag)
    )
    assert len(found) == len(known) == 10
    for one, other in zip(known, found, strict=True):
        assert (other.stamp_s, other.depth_late_s) == pytest.approx((one.stamp_s, one.depth_late_s), abs=1e-9)
        assert_allclose(other.depth_m, one.depth_m, atol=0.0 if images == "raw" else 5.1e-4)
        off = np.abs(other.color.astype(int) - one.color)
        assert off.max() == 0 if images != "jpeg" else 0 < off.mean() < 10
    assert open_recording(bag).calibration.color == open_recording(room).calibration.color
    encodings = {one.type for one in messages_in(bag) if "image_raw" in one.topic}
    assert encodings == {
        ("sensor_msgs/" + ("msg/" if suffix == ".mcap" else "")) + ("Image" if images == "raw" else "CompressedImage")
    }


def test_what_is_not_to_be_written_is_refused_in_one_line(refusal: Refusal, driven: Path, tmp_path: Path) -> None:
    assert "does not end in .mcap or .bag" in refusal("export", driven, "--bag", tmp_path / "out.db3")
    assert "--images is 'gif' (one of raw, png, jpeg)" in refusal(
        "export", driven, "--bag", tmp_path / "a.bag", "--images", "gif"
    )
    assert "--bag and --format are two files" in refusal(
        "export", driven, "--bag", tmp_path / "a.bag", "--format", "tum"
    )
    assert "name the file behind --bag" in refusal(
        "export", driven, "--bag", tmp_path / "a.bag", "--out", tmp_path / "b.bag"
    )
    assert "there is no such folder or file" in refusal("export", tmp_path / "none", "--bag", tmp_path / "a.bag")
    (tmp_path / "a.bag").write_text("mine")
    assert "is there already" in refusal("export", driven, "--bag", tmp_path / "a.bag")
    assert (tmp_path / "a.bag").read_text() == "mine"
    (tmp_path / "folder.bag").mkdir()
    assert "is a folder" in refusal("export", driven, "--bag", tmp_path / "folder.bag", "--force")
    assert {path.name for path in tmp_path.iterdir()} == {"wheels", "out", "a.bag", "folder.bag"}


def test_a_recording_that_has_gone_is_said_and_the_rest_is_written(
    wheelsight: Command, refusal: Refusal, driven: Path, wheels: Path, tmp_path: Path
) -> None:
    wheels.rename(tmp_path / "elsewhere")
    answer = wheelsight("export", driven, "--bag", tmp_path / "out.mcap")
    assert answer.exit_code == 0, answer.output
    assert "There are no topics of sensors" in answer.stderr
    assert len(on_topic(tmp_path / "out.mcap", "/odom")) > 100
    reported = refusal("export", driven, "--bag", tmp_path / "more.mcap", "--images", "raw")
    assert "the run's recording is not there any more" in reported
    assert not (tmp_path / "more.mcap").exists()


def test_a_recording_is_found_from_any_folder(
    wheelsight: Command, wheels: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert wheelsight("run", wheels.name, "--odometry", "wheels", "--out", "out").exit_code == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    answer = wheelsight("export", tmp_path / "out", "--bag", "out.mcap")
    assert answer.exit_code == 0, answer.output
    assert "There are no topics of sensors" not in answer.stderr


@BOTH
def test_a_full_disk_leaves_nothing(
    refusal: Refusal, driven: Path, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = writing.BagFile.add
    before = {path.name for path in tmp_path.iterdir()}

    def add(bag: writing.BagFile, *given: Any, **how: Any) -> None:
        if bag.count == 100:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written(bag, *given, **how)

    monkeypatch.setattr(writing.BagFile, "add", add)
    bag = tmp_path / f"out{suffix}"
    assert refusal("export", driven, "--bag", bag).startswith(f"{bag}: no space left on the disk")
    assert {path.name for path in tmp_path.iterdir()} == before


def test_without_rosbags_the_fix_is_said(
    refusal: Refusal, driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    assert refusal("export", driven, "--bag", tmp_path / "a.bag") == "rosbags is missing (pip install rosbags)"


def test_progress_is_shown(wheelsight: Command, driven: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    answer = wheelsight("export", driven, "--bag", tmp_path / "out.mcap")
    assert "writing" in answer.stderr
