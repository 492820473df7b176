from __future__ import annotations

from pathlib import Path

import pytest
from synthetic import make_tum_recording

from wheelsight.core.geometry import PinholeCamera

SMALL_CAMERA = PinholeCamera(64, 48, 52.0, 52.0, 31.5, 23.5)


@pytest.fixture
def small_camera() -> PinholeCamera:
    return SMALL_CAMERA


@pytest.fixture
def tum_folder(tmp_path: Path) -> Path:
    """A sound TUM recording of six small frames with ground truth and calibration.yaml."""
    folder = tmp_path / "sound"
    make_tum_recording(folder, frames=6, camera=SMALL_CAMERA)
    return folder
