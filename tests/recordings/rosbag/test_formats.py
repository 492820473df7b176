"""Every way in which bags are stored: the same drive comes out of each."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from narrowing import as_frame
from written_bags import COLOR, FRAMES, START_S, camera_drive, color_image, depth_mm, halves, write_bag

from wheelsight.core.messages import RgbdFrame
from wheelsight.io.recordings import ListedFrame, ListsFrames, Recording, find_recordings, open_recording

WAYS = {
    "ROS 1": (True, {}),
    "ROS 1, bz2": (True, {"compression": "bz2"}),
    "ROS 1, lz4": (True, {"compression": "lz4"}),
    "sqlite3": (False, {"storage": "sqlite3"}),
    "sqlite3, zstd by message": (False, {"storage": "sqlite3", "mode": "message"}),
    "sqlite3, zstd by file": (False, {"storage": "sqlite3", "mode": "file"}),
    "MCAP": (False, {}),
    "MCAP, zstd by message": (False, {"mode": "message"}),
    "MCAP, zstd by chunk": (False, {"mode": "storage"}),
}


def check(recording: Recording) -> None:
    """All frames are there, as they were written."""
    assert (recording.format, recording.body) == ("rosbag", "base")
    frames = [as_frame(event) for event in recording.events()]
    assert [frame.index for frame in frames] == list(range(FRAMES))
    for number, frame in enumerate(frames):
        assert frame.stamp_s == pytest.approx(START_S + 0.1 + number / 30, abs=2e-6)
        assert frame.depth_late_s == pytest.approx(0.001, abs=2e-6)
        np.testing.assert_array_equal(frame.color, color_image(number))
        np.testing.assert_allclose(frame.depth_m, depth_mm(number) / 1000, rtol=1e-6)
    association = recording.association
    assert (association.color_images, association.depth_images, association.pairs) == (FRAMES, FRAMES, FRAMES)
    assert association.largest_gap_s == pytest.approx(0.001, abs=2e-6)


@pytest.mark.parametrize("way", WAYS)
def test_each_way_of_storing_is_read(tmp_path: Path, way: str) -> None:
    is_ros1, how = WAYS[way]
    check(open_recording(write_bag(tmp_path / ("drive.bag" if is_ros1 else "drive"), camera_drive(is_ros1), **how)))


@pytest.mark.parametrize("how", [{}, {"storage": "sqlite3"}, {"storage": "sqlite3", "mode": "message"}])
def test_a_file_without_its_metadata_is_read(tmp_path: Path, how: dict[str, str]) -> None:
    folder = write_bag(tmp_path / "drive", camera_drive(), **how)
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    check(open_recording(file))
    check(open_recording(folder))
    assert find_recordings(tmp_path) == [folder]


@pytest.mark.parametrize("is_ros1", [True, False])
def test_parts_in_one_folder_are_one_bag(tmp_path: Path, is_ros1: bool) -> None:
    together = tmp_path / "together"
    together.mkdir()
    for number, part in enumerate(halves(camera_drive(is_ros1))):
        # The tenth comes after the ninth, not after the first.
        written = write_bag(tmp_path / f"part{number}{'.bag' if is_ros1 else ''}", part)
        file = written if is_ros1 else next(written.glob("*.mcap"))
        shutil.move(file, together / f"drive_{9 + number}{file.suffix}")
    check(open_recording(together))


def test_two_bags_in_one_folder_are_no_bag(tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        write_bag(tmp_path / f"{name}.bag", camera_drive(is_ros1=True))
    assert find_recordings(tmp_path) == [tmp_path / "monday.bag", tmp_path / "tuesday.bag"]


def test_frames_are_known_of_before_they_are_decoded(tmp_path: Path) -> None:
    recording = open_recording(write_bag(tmp_path / "drive", camera_drive()))
    assert isinstance(recording, ListsFrames)
    listed = [item for item in recording.listed() if isinstance(item, ListedFrame)]
    assert [frame.next_stamp_s for frame in listed] == [*(frame.stamp_s for frame in listed[1:]), float("inf")]
    # The bag is closed by now; a frame that was listed can be read all the same, and again.
    for _ in range(2):
        frame = listed[2].read()
        assert isinstance(frame, RgbdFrame)
        np.testing.assert_array_equal(frame.color, color_image(2))
    assert list(recording.events(images=False)) == []


def test_counts_of_the_index_stand_until_a_pass_went_through(tmp_path: Path) -> None:
    drive = camera_drive()
    at = next(index for index, (_, topic, _) in enumerate(drive.messages) if topic == COLOR)
    del drive.messages[at]
    drive.add(9.0, COLOR, drive.make.image(8.95, "camera_color_optical_frame", "rgb8", color_image(0)))
    recording = open_recording(write_bag(tmp_path / "drive", drive))
    assert recording.frame_count == FRAMES
    assert len(list(recording.events())) == recording.frame_count == FRAMES - 1
    assert (recording.association.dropped_color, recording.association.dropped_depth) == (1, 1)


def test_two_passes_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    recording = open_recording(write_bag(tmp_path / "drive.bag", camera_drive(is_ros1=True), compression="lz4"))
    pairs = list(zip(recording.events(), recording.events(), strict=True))
    assert len(pairs) == FRAMES
    for one, other in pairs:
        np.testing.assert_array_equal(as_frame(one).depth_m, as_frame(other).depth_m)
