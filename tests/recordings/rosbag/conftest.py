from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from written_bags import Drive, write_bag

from wheelsight.io.recordings import OpenOptions, open_recording
from wheelsight.io.recordings.bags.recording import BagRecording


@pytest.fixture
def opened(tmp_path: Path) -> Callable[..., BagRecording]:
    """Writes a drive as a bag and opens it; options of `OpenOptions` by name."""

    def open_drive(drive: Drive, **options: Any) -> BagRecording:
        number = len(list(tmp_path.iterdir()))
        path = write_bag(tmp_path / f"drive{number}{'.bag' if drive.is_ros1 else ''}", drive)
        recording = open_recording(path, OpenOptions(**options))
        assert isinstance(recording, BagRecording)
        return recording

    return open_drive
