"""What a run follows where nobody named an odometry."""

from __future__ import annotations

from dataclasses import replace

import pytest
from room_drive import make_room_drive

from wheelsight.config import load_config
from wheelsight.pipeline import Choice, default_odometry
from wheelsight.recordings import open_recording
from wheelsight.recordings._image_recording import ImageRecording


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> ImageRecording:
    folder = tmp_path_factory.mktemp("choice") / "drive"
    make_room_drive(folder, frames=4)
    recording = open_recording(folder)
    assert isinstance(recording, ImageRecording)
    return recording


def test_all_sensors_are_joined(drive: ImageRecording) -> None:
    assert default_odometry(drive, load_config()) == Choice(("wheels", "dense"))


def test_settings_of_features_ask_for_these(drive: ImageRecording) -> None:
    by_features = load_config(overrides={"features.reference": "previous"})
    assert default_odometry(drive, by_features).odometry == ("wheels", "features")
    mapped = load_config(overrides={"features.seed": 3, "map": "surfels", "odometry": "dense"})
    assert default_odometry(drive, mapped).odometry == ("wheels", "dense")


@pytest.mark.parametrize(
    ("lacks", "why"),
    [({"T_base_camera": None}, "has no T_base_camera (wheelsight calibrate base"), ({"wheels": None}, "has no wheels")],
)
def test_what_is_not_used_is_said(drive: ImageRecording, lacks: dict[str, None], why: str) -> None:
    calibration = replace(drive.calibration, **lacks)
    choice = default_odometry(replace(drive, calibration=calibration), load_config())
    assert choice.odometry == ("features",)
    assert choice.unused.startswith(f"{drive.wheel_count} wheel readings are not used: the calibration {why}")


def test_frames_without_cameras_are_not_used(drive: ImageRecording) -> None:
    calibration = replace(drive.calibration, color=None, depth=None)
    choice = default_odometry(replace(drive, calibration=calibration), load_config())
    assert choice == Choice(("wheels",), f"{drive.frame_count} frames are not used: the calibration has no cameras")


def test_one_sensor_leaves_nothing_over(drive: ImageRecording) -> None:
    assert default_odometry(replace(drive, wheels=()), load_config()) == Choice(("features",))
