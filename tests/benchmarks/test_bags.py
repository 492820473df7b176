"""The benchmark of bags writes bags that are read as they are meant to be."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import bags
from wheelsight.io.recordings import open_recording
from wheelsight_export.bag_writing import ImageForm


@pytest.mark.parametrize("kind", bags.KINDS, ids=lambda kind: kind.name)
def test_each_kind_holds_camera_and_wheels(tmp_path: Path, kind: bags.Kind) -> None:
    path = bags.write(tmp_path / "bag", kind, 6, (64, 48), one_a_chunk=True)
    recording = open_recording(path)
    assert (recording.frame_count, recording.wheel_count) == (6, 10)
    assert bags.read_rate(path, 6) > 0
    assert bags.opening_s(path) > 0


@pytest.mark.parametrize(("suffix", "images"), [(suffix, images) for suffix, images, _ in bags.OWN])
def test_what_is_measured_of_writing_is_a_bag_with_all_frames(tmp_path: Path, suffix: str, images: ImageForm) -> None:
    path = tmp_path / f"written{suffix}"
    assert bags.write_rate(path, images, 3) > 0
    assert open_recording(path).frame_count == 3
