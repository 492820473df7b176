"""Bags that are damaged, lack what is needed, or whose clocks are wrong: refused in one line, or said."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from written_bags import (
    COLOR,
    DEPTH,
    FRAMES,
    OPTICAL,
    START_S,
    Drive,
    Messages,
    camera_drive,
    color_image,
    odometry_drive,
    write_bag,
)

from wheelsight.core.errors import InputError, RecordingError
from wheelsight.core.messages import RgbdFrame, SkippedFrame, WheelSpeeds
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.bags.images import depth_of
from wheelsight.io.recordings.bags.storage import OpenBag
from wheelsight.io.recordings.clock_checks import FRAMES as FRAME_STAMPS
from wheelsight.io.recordings.clock_checks import WHEELS, listed_stamps, refuse_if_apart
from wheelsight_export.bag_writing import new_bag


def test_metadata_of_gigabytes_is_not_read(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive", odometry_drive(), storage="sqlite3")
    os.truncate(folder / "metadata.yaml", 10 << 30)
    with pytest.raises(
        RecordingError, match=r"metadata\.yaml: holds 10240 MB, more than metadata\.yaml of a bag may: 256 kB"
    ):
        open_recording(folder)


def file_of(folder: Path, is_ros1: bool = False, frames: int = FRAMES, **how: str) -> Path:
    written = write_bag(folder / ("drive.bag" if is_ros1 else "drive"), camera_drive(is_ros1, frames), **how)
    return written if is_ros1 else next(file for file in written.iterdir() if file.suffix != ".yaml")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("way", ["ROS 1", "mcap", "sqlite3"])
def test_a_bag_that_is_cut_off_is_refused_in_one_line_or_read_in_part(tmp_path: Path, way: str, share: float) -> None:
    path = file_of(tmp_path, is_ros1=True) if way == "ROS 1" else file_of(tmp_path, storage=way)
    data = path.read_bytes()
    alone = tmp_path / "alone"
    alone.mkdir()
    cut = alone / path.name
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(RecordingError) as caught:
        list(open_recording(cut).events())
    assert caught.value.path == cut
    assert caught.value.fix
    assert "\n" not in str(caught.value)


def test_a_bag_without_an_index_says_how_to_make_one(tmp_path: Path) -> None:
    path = file_of(tmp_path, is_ros1=True)
    data = bytearray(path.read_bytes())
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"has no index: its recorder did not end it \(rosbag reindex drive.bag\)"):
        open_recording(path)


@pytest.mark.parametrize("missing", [1, 9, 37, 300])
def test_an_mcap_without_an_end_is_read_and_that_is_said(tmp_path: Path, missing: int) -> None:
    path = file_of(tmp_path)
    path.write_bytes(path.read_bytes()[:-missing])
    (tmp_path / "drive" / "metadata.yaml").unlink()
    recording = open_recording(path)
    assert recording.warnings[0].startswith("drive.mcap has no end, as where its recorder was killed.")
    assert len(list(recording.events())) == FRAMES


def test_an_mcap_that_is_cut_in_a_chunk_keeps_the_chunks_before(tmp_path: Path) -> None:
    path = file_of(tmp_path, frames=150)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    recording = open_recording(path)
    assert "bytes after them are no whole record" in recording.warnings[0]
    assert 20 < len(list(recording.events())) < 150


def test_messages_of_a_cut_mcap_are_put_in_order(tmp_path: Path) -> None:
    drive = camera_drive()
    ordered = sorted(drive.messages, key=lambda item: item[0])
    path = tmp_path / "drive.mcap"
    with new_bag(path) as bag:
        for at_s, topic, message in (*ordered[3:], *ordered[:3]):
            bag.add(topic, message, START_S + at_s)
    path.write_bytes(path.read_bytes()[:-9])
    stamps_s = [event.stamp_s for event in open_recording(path).events()]
    np.testing.assert_allclose(stamps_s, START_S + 0.1 + np.arange(FRAMES) / 30, atol=1e-5)


@pytest.mark.parametrize("name", ["text.bag", "text.mcap", "text.db3"])
@pytest.mark.parametrize("data", [b"", b"no bag at all\n" * 50])
def test_a_file_that_is_only_called_a_bag(tmp_path: Path, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError):
        open_recording(tmp_path / name)


def test_bytes_that_were_changed_raise_nothing_but_our_own_errors(tmp_path: Path, rng: np.random.Generator) -> None:
    for way in ("mcap", "sqlite3"):
        path = file_of(tmp_path / way, storage=way)
        whole = path.read_bytes()
        for _ in range(15):
            damaged = np.frombuffer(whole, np.uint8).copy()
            damaged[rng.integers(0, len(whole), 40)] = rng.integers(0, 256, 40)
            path.write_bytes(damaged.tobytes())
            try:
                events = list(open_recording(path).events())
            except InputError:
                continue
            assert all(isinstance(event, RgbdFrame | SkippedFrame) for event in events)


def test_metadata_that_does_not_fit_may_be_removed(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive", camera_drive())
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 4}")
    with pytest.raises(RecordingError, match=r"remove metadata\.yaml"):
        open_recording(folder)
    (folder / "metadata.yaml").unlink()
    assert len(list(open_recording(folder).events())) == FRAMES


def test_a_part_that_is_missing_is_said(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "drive", camera_drive())
    (only,) = folder.glob("*.mcap")
    shutil.move(only, folder / "other.mcap")
    with pytest.raises(RecordingError, match=r"files that metadata\.yaml names are missing"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("drive", "problem"),
    [
        (Drive(), "holds no messages"),
        (camera_drive().without(DEPTH), f"since no depth images match them: {COLOR}"),
        (camera_drive().without(COLOR), f"since no colour images match them: {DEPTH}"),
        (
            camera_drive().without(COLOR, DEPTH),
            "no depth images with colour, no counts or speeds of wheels, no odom → base_link in tf, no Odometry, "
            "no JointState of wheels",
        ),
    ],
)
def test_what_a_bag_lacks_is_said(opened, drive: Drive, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem):
        opened(drive)


def test_half_a_camera_beside_wheels_is_said_and_the_wheels_are_read(opened) -> None:
    drive = camera_drive().without(DEPTH)
    drive.messages += odometry_drive().messages
    recording = opened(drive)
    assert (recording.frame_count, recording.wheel_count, recording.body) == (0, 60, "base")
    assert any("since no depth images match" in warning for warning in recording.warnings)


def test_an_image_that_cannot_be_read_is_skipped_with_its_reason(opened) -> None:
    drive = camera_drive()
    drive.messages = [
        (at_s, topic, drive.make.image(number / 30, OPTICAL, "rgb8", color_image(0)[:9]) if number == 7 else message)
        for number, (at_s, topic, message) in enumerate(drive.messages)
    ]
    replaced = sum(topic == COLOR for _, topic, _ in drive.messages[7:8])
    assert replaced == 1
    drive.messages[7][2].header = drive.make.header(0.1 + 2 / 30, OPTICAL)
    events = list(opened(drive).events())
    (skipped,) = (event for event in events if isinstance(event, SkippedFrame))
    assert (skipped.index, skipped.reason) == (2, "colour image is 64×9, the calibration's 64×48")
    assert len(events) == FRAMES


def test_no_image_at_all_can_be_read(opened) -> None:
    drive = camera_drive()
    for _, topic, message in drive.messages:
        if topic == COLOR:
            message.encoding = "nv12"
    with pytest.raises(RecordingError, match="colour images are encoded as 'nv12'"):
        opened(drive)


def test_images_of_different_clocks_find_no_partner(opened) -> None:
    drive = camera_drive()
    for _, topic, message in drive.messages:
        if topic == DEPTH:
            message.header.stamp.sec += 3
    with pytest.raises(
        RecordingError, match=r"no depth image lies within 0\.02 s .* the nearest is 2\.9\d+ s away"
    ) as no:
        opened(drive)
    assert "max-gap" not in str(no.value)


def stamped(topic: str, drive: Drive, change_s: int | None) -> Drive:
    """A drive whose headers of a topic are so many seconds off, or zero."""
    for _, name, message in drive.messages:
        if name == topic and change_s is None:
            message.header.stamp.sec = message.header.stamp.nanosec = 0
        elif name == topic:
            message.header.stamp.sec += change_s
    return drive


def both() -> Drive:
    drive = camera_drive(late_s=0.05)
    drive.messages += odometry_drive().messages
    return drive


def test_images_without_stamps_are_stamped_by_receipt(opened) -> None:
    recording = opened(stamped(DEPTH, stamped(COLOR, both(), None), None))
    reported = [warning for warning in recording.warnings if "the time of receipt is used" in warning]
    assert [warning.partition(":")[0] for warning in reported] == [COLOR, DEPTH]
    frames = [event for event in recording.events() if isinstance(event, RgbdFrame)]
    assert [frame.stamp_s for frame in frames] == pytest.approx(
        [START_S + 0.15 + n / 30 for n in range(FRAMES)], abs=1e-5
    )


def test_headers_that_are_all_off_by_the_same_are_a_replays(opened) -> None:
    drive = both()
    for topic in (COLOR, DEPTH, "/odom"):
        stamped(topic, drive, -100_000)
    recording = opened(drive)
    assert any("a replay was recorded" in warning for warning in recording.warnings)
    first = next(event for event in recording.events() if isinstance(event, WheelSpeeds))
    assert first.stamp_s == START_S - 100_000


def test_a_single_wrong_header_is_left_out_and_one_of_zero_is_replaced(opened) -> None:
    drive = odometry_drive()
    drive.messages[20][2].header.stamp.sec += 5000
    drive.messages[30][2].header.stamp.sec = drive.messages[30][2].header.stamp.nanosec = 0
    recording = opened(drive)
    stamps_s = [event.stamp_s for event in recording.events()]
    np.testing.assert_allclose(stamps_s, START_S + np.delete(np.arange(60), 20) / 20, atol=1e-5)
    assert any("/odom: 1 messages were left out" in warning for warning in recording.warnings)
    assert any("/odom: 1 headers are 0" in warning for warning in recording.warnings)


def test_messages_that_come_twice_are_left_out_and_counted(opened) -> None:
    drive = camera_drive()
    drive.messages += [(at_s + 1e-4, topic, m) for at_s, topic, m in drive.messages if topic in (COLOR, DEPTH)]
    recording = opened(drive)
    assert len(list(recording.events())) == FRAMES
    assert any("came twice, or with the stamp of another" in warning for warning in recording.warnings)


def test_camera_and_wheels_that_share_no_time_are_refused_before_a_run(opened) -> None:
    drive = camera_drive()
    for at_s, topic, message in odometry_drive().messages:
        message.header.stamp.sec += 5
        drive.add(at_s + 5, topic, message)
    recording = opened(drive)
    stamps = listed_stamps(recording)
    assert stamps[FRAME_STAMPS][-1] == pytest.approx(START_S + 0.1 + 5 / 30, abs=1e-5)
    assert (stamps[WHEELS][0], stamps[WHEELS][-1]) == pytest.approx((START_S + 5, START_S + 7.95))
    assert any("share 0.0 s" in warning for warning in recording.warnings)
    with pytest.raises(RecordingError, match="their clocks count from different moments"):
        refuse_if_apart(recording)


def test_the_last_message_of_a_topic_that_ends_early_is_found(opened) -> None:
    drive = camera_drive()
    drive.messages += odometry_drive(seconds=60, rate_hz=5).messages
    stamps = listed_stamps(opened(drive))
    assert stamps[FRAME_STAMPS][-1] == pytest.approx(START_S + 0.1 + 5 / 30, abs=1e-5)
    assert stamps[WHEELS][-1] == pytest.approx(START_S + 59.8)


@pytest.mark.parametrize(("is_ros1", "fix"), [(True, "rosbag reindex drive.bag"), (False, "mcap recover")])
def test_an_index_of_messages_that_are_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_ros1: bool, fix: str
) -> None:
    path = file_of(tmp_path, is_ros1)
    monkeypatch.setattr(OpenBag, "messages", lambda *_, **__: iter(()))
    with pytest.raises(RecordingError, match=r"its index has messages of .*, and the file has none") as caught:
        open_recording(path)
    assert fix in str(caught.value)


def test_depth_that_is_no_number_is_not_measured(tmp_path: Path) -> None:
    """Among them a signalling NaN, which processors complain of, and what is infinite once it is scaled."""
    pixels = np.full((4, 6), 2.0, np.float32)
    pixels.view(np.uint32)[0, :4] = 0x7FA00000, 0x7FC00000, 0x7F800000, 0xFF800000
    pixels[1, :2] = 3e38, -1.0
    depth_m = depth_of(Messages(is_ros1=False).image(0.0, OPTICAL, "32FC1", pixels), 0.5, tmp_path)
    assert (depth_m[0, :4] == 0).all()
    assert (depth_m[1, :2] == 0).all()
    assert (depth_m[2:] == 4.0).all()


@pytest.mark.parametrize("value", [1e200, float("nan"), float("inf"), -1e300])
def test_numbers_that_nothing_measures_are_counted_and_left_out(opened, value: float) -> None:
    drive = odometry_drive()
    drive.messages += camera_drive().messages
    for at_s in np.arange(0, 3, 0.1).tolist():
        rate = value if at_s == 1.0 else 0.3
        drive.add(at_s, "/imu", drive.make.imu(at_s, "base_link", (0, 0, rate), (0, 0, 9.81)))
    odometry = [message for _, topic, message in drive.messages if topic == "/odom"]
    odometry[20].pose.pose.orientation.z = value
    odometry[30].pose.pose.position.x = value
    odometry[40].twist.twist.linear.x = value
    drive.add(0.0, "/tf", drive.make.tf(("base_link", "odd", (0, 0, 0), (0, 0, 0, value))))
    recording = opened(drive)
    assert sum(isinstance(event, WheelSpeeds) for event in recording.events()) == 57
    assert any("4 messages hold no numbers of wheels or gyroscope" in warning for warning in recording.warnings)
    assert any("from base_link to odd is no rigid motion" in warning for warning in recording.warnings)


@pytest.mark.parametrize("field", ["d", "k", "p"])
def test_a_camera_of_impossible_numbers_is_refused(opened, field: str) -> None:
    drive = camera_drive()
    for _, topic, message in drive.messages:
        if topic.endswith("camera_info"):
            setattr(message, field, np.full({"d": 5, "k": 9, "p": 12}[field], 1e300))
    with pytest.raises(InputError, match="CameraInfo holds an invalid number"):
        opened(drive)


@pytest.mark.parametrize("way", ["ROS 1", "mcap", "sqlite3"])
@pytest.mark.parametrize("topic", [COLOR, "/camera/color/camera_info", "/odom", "/imu"])
def test_a_frame_that_is_no_text_is_refused(tmp_path: Path, way: str, topic: str) -> None:
    is_ros1 = way == "ROS 1"
    drive = camera_drive(is_ros1)
    drive.messages += odometry_drive(is_ros1).messages
    for at_s in np.arange(0, 3, 0.1).tolist():
        drive.add(at_s, "/imu", drive.make.imu(at_s, "imu_frame", (0, 0, 0.3), (0, 0, 9.81)))
    for _, name, message in drive.messages:
        if name == topic:
            message.header.frame_id = "f" * 33
    written = write_bag(tmp_path / ("drive.bag" if is_ros1 else "drive"), drive, **{} if is_ros1 else {"storage": way})
    path = written if is_ros1 else next(file for file in written.iterdir() if file.suffix != ".yaml")
    data = path.read_bytes()
    assert b"f" * 33 in data
    path.write_bytes(data.replace(b"f" * 33, b"\xf0" * 33))
    with pytest.raises(RecordingError, match=f"a message of {topic} "):
        list(open_recording(path).events())


def test_an_index_whose_times_are_wrong_leaves_gravity_unknown(opened, monkeypatch: pytest.MonkeyPatch) -> None:
    """The gyroscope's chunks seem to begin after the messages in them, so that none lies in the first seconds."""
    drive = odometry_drive()
    for at_s in np.arange(0, 3, 0.1).tolist():
        drive.add(at_s, "/imu", drive.make.imu(at_s, "imu_frame", (0, 0, 0.3), (0, 0, 9.81)))
    whole = OpenBag.messages

    def messages(bag: OpenBag, topics: Sequence[str], start_ns: int | None = None, stop_ns: int | None = None):
        return iter(()) if list(topics) == ["/imu"] and stop_ns is not None else whole(bag, topics, start_ns, stop_ns)

    monkeypatch.setattr(OpenBag, "messages", messages)
    assert any("neither tf nor gravity shows which way is up" in warning for warning in opened(drive).warnings)
