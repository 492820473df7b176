"""The benchmark of bags writes bags that are read as they are meant to be."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import bags
from wheelsight.recordings import open_recording


@pytest.mark.parametrize("kind", bags.KINDS, ids=lambda kind: kind.name)
def test_each_kind_holds_camera_and_wheels(tmp_path: Path, kind: bags.Kind) -> None:
    path = bags.write(tmp_path / "bag", kind, 6, (64, 48), one_a_chunk=True)
    recording = open_recording(path)
    assert (recording.frame_count, recording.wheel_count) == (6, 10)
    assert bags.read_rate(path, 6) > 0
    assert bags.opening_s(path) > 0
