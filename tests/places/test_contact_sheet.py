"""ContactSheet: which frames are shown, and borders with which a page left as it is says what was proposed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places.made import NAMES, frame_of
from places.made_recording import write_drive
from stand_ins import MemoryRecording

from wheelsight.core.errors import PlaceError
from wheelsight.core.messages import SkippedFrame
from wheelsight.io.recordings import open_recording
from wheelsight_papers import chosen_frames, label_source, make_sheet, stamps_of


def test_frames_are_chosen_in_the_middle_of_each_part() -> None:
    stamps_s = 100 + 0.1 * np.arange(101, dtype=float)
    assert chosen_frames(stamps_s, 2.0) == [10, 30, 50, 70, 90]
    assert chosen_frames(stamps_s[:1], 2.0) == [0]
    assert chosen_frames(np.array([0.0, 0.2, 9.8, 10.0]), 2.0) == [1, 2]  # a gap is not filled


def test_a_sheet_proposes_each_thumbnails_area_and_where_the_robot_was(tmp_path: Path) -> None:
    recording = open_recording(write_drive(tmp_path / "drive", start_s=50.0))
    seen: list[int] = []
    sheet = make_sheet(recording, label_source(recording), 1.0, lambda: seen.append(1))
    assert (sheet.name, sheet.frame_count, sheet.every_s, sheet.names) == ("drive", 60, 1.0, NAMES)
    assert sheet.labels.tolist() == [0, 0, 1, 1, 2, 2]
    assert len(sheet.pictures) == len(seen) == 6
    assert sheet.pictures[0].shape == (24, 32, 3)
    np.testing.assert_allclose(sheet.xy_m[:, 0] // 3, sheet.labels)
    assert (sheet.borders_s[0], sheet.borders_s[-1]) == pytest.approx((50.0, 55.9))


@pytest.mark.parametrize("every_s", [0.3, 0.7, 1.0, 1.9])
def test_ranges_by_its_borders_are_the_proposal(tmp_path: Path, every_s: float) -> None:
    recording = open_recording(write_drive(tmp_path / "drive"))
    source = label_source(recording)
    sheet = make_sheet(recording, source, every_s)
    stamps_s = np.array(stamps_of(recording))
    part = np.searchsorted(sheet.borders_s, stamps_s, side="right").clip(1, len(sheet.labels)) - 1
    np.testing.assert_array_equal(sheet.labels[part], source.of_frames(stamps_s.tolist(), NAMES))


def test_long_drives_get_fewer_thumbnails_unless_asked_for(tmp_path: Path, rng: np.random.Generator) -> None:
    picture = frame_of(0, rng)
    events = [type(picture)(float(i), picture.color, picture.depth_m, i) for i in range(1801)]
    recording = MemoryRecording(events)
    assert len(make_sheet(recording, label_source(recording)).pictures) == 600
    assert len(make_sheet(recording, label_source(recording), 1.0).pictures) == 1800


def test_unusable_frames_are_left_out(tmp_path: Path, rng: np.random.Generator) -> None:
    folder = write_drive(tmp_path / "drive")
    sorted((folder / "rgb").iterdir())[chosen_frames(np.arange(60) / 10, 1.0)[1]].write_bytes(b"no image")
    recording = open_recording(folder)
    assert len(make_sheet(recording, label_source(recording), 1.0).pictures) == 5
    empty, dark = MemoryRecording([]), MemoryRecording([SkippedFrame(0.0, "dark")])
    with pytest.raises(PlaceError, match="memory has no frames"):
        make_sheet(empty, label_source(empty))
    with pytest.raises(PlaceError, match="memory has no usable frames"):
        make_sheet(dark, label_source(dark))
