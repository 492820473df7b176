"""What a run follows where no one named an odometry."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from narrowing import not_none
from room_drive import make_room_drive
from typer.testing import CliRunner

from wheelsight.app.cli import app
from wheelsight.app.run import Choice, default_odometry, resolved
from wheelsight.app.run.run_source import unused_of
from wheelsight.app.runs import run, run_each
from wheelsight.config import Config, OdometryName, load_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.estimates import Estimate
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import open_recording
from wheelsight.io.recordings.image_recording import ImageRecording


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
def test_what_is_not_used_is_said(drive: ImageRecording, lacks: dict[str, Any], why: str) -> None:
    calibration = replace(drive.calibration, **lacks)
    choice = default_odometry(replace(drive, calibration=calibration), load_config())
    assert choice.odometry == ("dense",)
    assert choice.unused.startswith(f"{drive.wheel_count} wheel readings are not used: the calibration {why}")


def test_frames_without_cameras_are_not_used(drive: ImageRecording) -> None:
    calibration = replace(drive.calibration, color=None, depth=None)
    choice = default_odometry(replace(drive, calibration=calibration), load_config())
    assert choice == Choice(("wheels",), f"{drive.frame_count} frames are not used: the calibration has no cameras")


def test_one_sensor_leaves_nothing_over(drive: ImageRecording) -> None:
    assert default_odometry(replace(drive, wheels=()), load_config()) == Choice(("dense",))
    assert default_odometry(replace(drive, frames=()), load_config()) == Choice(("wheels",))


def test_a_camera_alone_is_followed_by_what_settings_ask_for(drive: ImageRecording) -> None:
    mapped = load_config(overrides={"odometry": "wheels,dense", "map": "surfels"})
    assert default_odometry(replace(drive, wheels=()), mapped) == Choice(("dense",))


@pytest.mark.parametrize(
    ("overrides", "odometry"),
    [
        ({"profile": "pi"}, "features"),
        ({"features.keypoints": 900}, "features"),
        ({"features.keypoints": 900, "map": "surfels"}, "dense"),
        ({"profile": "pi", "map": "surfels"}, "dense"),
        ({"profile": "pi", "dense.lost_after": 5}, "dense"),
        ({"features.seed": 1}, "dense"),
        ({"profile": "pi", "features.seed": 1}, "features"),
    ],
)
def test_a_slow_computer_follows_a_camera_alone_by_features(
    drive: ImageRecording, overrides: dict[str, object], odometry: OdometryName
) -> None:
    assert default_odometry(replace(drive, wheels=()), load_config(overrides=overrides)) == Choice((odometry,))


def test_a_named_odometry_stays(drive: ImageRecording) -> None:
    named = load_config(overrides={"odometry": "wheels"})
    assert resolved(drive, named) is named


@pytest.mark.slow
@pytest.mark.usefixtures("real_odometry")
@pytest.mark.parametrize("config", [Config(), Config(odometry=("wheels", "dense"))])
def test_localizer_run_and_command_line_give_the_same_poses(
    drive: ImageRecording, tmp_path: Path, config: Config
) -> None:
    """To the bit: README's example, `run`, and `wheelsight run`."""
    record = run(drive, config, tmp_path / "run")
    assert record.odometry == "joined"
    answer = CliRunner().invoke(app, ["run", str(drive.path), "--out", str(tmp_path / "cli")])
    assert answer.exit_code == 0, answer.output
    posed = dict[float, Estimate]()
    with closing(Localizer(drive.calibration)) as localizer:
        for event in drive.events():
            estimate = localizer.process(event)
            if estimate is not None and estimate.T_odom_body is not None:
                posed[estimate.stamp_s] = estimate
        assert localizer.warnings == ()
    assert len(posed) > 50
    np.testing.assert_array_equal(record.estimate.stamps_s, list(posed))
    lived = [estimate.T_filter_body for estimate in posed.values()]
    np.testing.assert_array_equal(record.estimate.T_frame_body, np.array(lived))
    in_odom = [estimate.T_odom_body for estimate in posed.values()]
    np.testing.assert_allclose(not_none(record.odom).T_frame_body, np.array(in_odom), atol=1e-12)
    for name in ("trajectory.txt", "odom.txt", "covariances.csv"):
        ran, commanded = (tmp_path / where / "joined" / name for where in ("run", "cli"))
        assert ran.read_bytes() == commanded.read_bytes()
    assert (tmp_path / "run" / "config.yaml").read_bytes() == (tmp_path / "cli" / "config.yaml").read_bytes()


def test_wheels_alone_make_no_map(drive: ImageRecording) -> None:
    mapped = load_config(overrides={"odometry": "wheels,dense", "map": "surfels"})
    with pytest.raises(ConfigError, match=r"has no images for --map \(leave it out\)"):
        default_odometry(replace(drive, frames=()), mapped)


@pytest.mark.parametrize(
    "odometry", [("wheels", "dense"), ("wheels", "features"), ("wheels",), ("features",), ("dense",)]
)
def test_a_choice_shows_the_option_that_would_make_it(odometry: tuple[OdometryName, ...]) -> None:
    reported = Choice(odometry).sentence
    assert f"(--odometry {','.join(odometry)}" in reported
    assert "\n" not in reported


@pytest.mark.parametrize(
    ("overrides", "unused"),
    [
        (
            {"odometry": "dense"},
            ["{w} wheel readings are not used: --odometry dense leaves them out.", "go with wheels"],
        ),
        (
            {"odometry": "features,dense"},
            ["{w} wheel readings are not used: --odometry features,dense leaves them out.", "go with wheels"],
        ),
        ({"odometry": "wheels"}, ["{f} frames are not used: --odometry wheels leaves them out."]),
        ({"odometry": "wheels,dense"}, []),
        ({"odometry": "wheels,dense", "wheels.gyro": False}, ["7 readings of the gyroscope are not used: --no-gyro"]),
    ],
)
def test_a_run_shows_what_it_leaves_out(drive: ImageRecording, overrides: dict[str, object], unused: list[str]) -> None:
    reported = unused_of(drive, load_config(overrides=overrides), yaw_rates=7)
    assert len(reported) == len(unused)
    for sentence, expected in zip(reported, unused, strict=True):
        assert expected.format(w=drive.wheel_count, f=drive.frame_count) in sentence


def test_a_run_shows_why_it_could_not(drive: ImageRecording) -> None:
    unmounted = replace(drive, calibration=replace(drive.calibration, T_base_camera=None))
    (reported,) = unused_of(unmounted, load_config(overrides={"odometry": "features"}), yaw_rates=0)
    assert reported.startswith(f"{drive.wheel_count} wheel readings are not used: the calibration has no T_base_camera")
    assert unused_of(replace(drive, wheels=()), load_config(overrides={"odometry": "features"}), yaw_rates=0) == ()


@pytest.mark.usefixtures("drawn_pages")
@pytest.mark.usefixtures("real_odometry")
@pytest.mark.parametrize("odometry", ["dense", "features,dense"])
def test_report_and_metrics_say_it_once(drive: ImageRecording, tmp_path: Path, odometry: str) -> None:
    records = run_each(drive, load_config(overrides={"odometry": odometry}), tmp_path / "out")
    sentence = f"{drive.wheel_count} wheel readings are not used: --odometry {odometry} leaves them out."
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["warnings"].count(sentence) == 1
    assert not any(sentence in found["warnings"] for found in metrics.get("odometry", {}).values())
    assert all(sentence in record.warnings for record in records)
    assert (tmp_path / "out" / "report.html").read_text().count(sentence) == 1
