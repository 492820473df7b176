"""Frames that are known of before they are decoded."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

from room_drive import make_room_drive

from wheelsight.core.messages import RgbdFrame, SkippedFrame
from wheelsight.io.recordings import ListedFrame, ListsFrames, open_recording


def test_listed_are_the_very_events_with_frames_still_to_be_decoded(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=2)
    recording = open_recording(tmp_path / "drive")
    assert isinstance(recording, ListsFrames)
    listed, events = list(recording.listed()), list(recording.events())
    assert [item.stamp_s for item in listed] == [event.stamp_s for event in events]
    frames = [item for item in listed if isinstance(item, ListedFrame)]
    assert [frame.next_stamp_s for frame in frames] == [*(frame.stamp_s for frame in frames[1:]), math.inf]
    assert all(frame.stamp_s < after.stamp_s for frame, after in pairwise(frames))
    decoded = frames[1].read()
    assert isinstance(decoded, RgbdFrame)
    assert decoded.index == 1


def test_a_listed_frame_that_cannot_be_read_says_so(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "drive", frames=2)
    recording = open_recording(tmp_path / "drive")
    assert isinstance(recording, ListsFrames)
    frames = [item for item in recording.listed() if isinstance(item, ListedFrame)]
    next(iter(sorted((tmp_path / "drive" / "rgb").iterdir()))).write_text("no image")
    assert isinstance(frames[0].read(), SkippedFrame)
