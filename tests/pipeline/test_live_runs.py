"""Runs over sources that have no end and know no counts, as a camera on a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pipeline.live import Live
from pipeline.made import BOTH, BY_FEATURES, FILES, WHEELS, frames_at, metrics_in, mixed_recording
from stand_ins import CAMERA, MemoryRecording

from wheelsight.app.run import Choice, default_odometry
from wheelsight.app.runs import run, run_each
from wheelsight.config import Config, load_config
from wheelsight.core.calibration import Calibration
from wheelsight.core.errors import ConfigError
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.robots import EventSource
from wheelsight.core.trajectory import Trajectory
from wheelsight.estimation import Localizer
from wheelsight.io.recordings import Recording

MOUNT = np.array([[0.0, 0, 1, 0.2], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])


def test_a_source_without_an_end_stops_after_a_while(tmp_path: Path, truth: Trajectory) -> None:
    source = Live(truth)
    record = run(source, BY_FEATURES, tmp_path / "out", duration_s=0.5)
    assert [f.stamp_s for f in record.frames] == pytest.approx([100 + index / 30 for index in range(15)])
    assert source.is_closed
    assert len(source.given) == 16  # the first that is late shows that it is over
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    metrics = metrics_in(tmp_path / "out")
    assert metrics["recording"] == {"name": "robot", "format": "live", "path": None}
    assert (metrics["frames"]["listed"], metrics["frames"]["processed"]) == (None, 15)
    assert metrics["frames"]["dropped_color_images"] is None
    assert (metrics["interrupted"], metrics["evaluation"]) == (False, None)
    assert metrics["evaluation_problem"] == "the live source has no ground truth"
    assert record.warnings == ("The camera is warm.",)


def test_ctrl_c_keeps_what_a_source_without_an_end_gave(tmp_path: Path, truth: Trajectory) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(Live(truth, stop_at=12), BY_FEATURES, tmp_path / "out")
    metrics = metrics_in(tmp_path / "out")
    assert metrics["interrupted"]
    assert metrics["frames"]["with_pose"] == 12
    assert metrics["warnings"][-1] == "Interrupted by the user after 12 frames."


def test_pictures_are_taken_though_no_one_knows_for_how_long(tmp_path: Path, truth: Trajectory) -> None:
    settings = load_config(overrides={"odometry": "features", "report.pictures": 3})
    record = run(Live(truth), settings, tmp_path / "out", duration_s=0.5)
    assert [picture.stamp_s for picture in record.pictures] == pytest.approx([100 + 10 / 30])


def test_wheels_alone_need_no_images(tmp_path: Path, truth: Trajectory) -> None:
    source = Live(truth, Calibration(wheels=WHEELS))
    record = run(source, load_config(overrides={"odometry": "wheels"}), tmp_path / "out", duration_s=1)
    assert len(record.frames) == 50
    assert not any(isinstance(event, RgbdFrame) for event in source.given)


def test_an_odometry_is_chosen_by_the_calibration(truth: Trajectory) -> None:
    assert default_odometry(Live(truth), Config()) == Choice(
        ("dense",), "wheel readings are not used: the calibration has no wheels (give them by --calibration)"
    )
    by_wheels = default_odometry(Live(truth, Calibration(wheels=WHEELS)), Config())
    assert by_wheels.odometry == ("wheels",)
    both = Calibration.registered_camera(CAMERA, wheels=WHEELS, T_base_camera=MOUNT)
    assert default_odometry(Live(truth, both), Config()) == Choice(("wheels", "dense"))


def test_wheels_that_may_come_are_said_to_be_left_out(tmp_path: Path, truth: Trajectory) -> None:
    source = Live(truth, Calibration.registered_camera(CAMERA, wheels=WHEELS))
    record = run(source, BY_FEATURES, tmp_path / "out", duration_s=0.2)
    assert record.warnings[-1].startswith("Wheel readings are not used: the calibration has no T_base_camera")


def test_places_of_a_live_source_are_given_by_name(tmp_path: Path, truth: Trajectory) -> None:
    settings = load_config(overrides={"odometry": "wheels", "places": {"model": "a.places"}})
    with pytest.raises(ConfigError, match=r"^robot: the recording has no areas.yaml .give --areas FILE"):
        run_each(Live(truth, Calibration(wheels=WHEELS)), settings, tmp_path / "out")


def test_a_recording_is_a_source_with_more(truth: Trajectory) -> None:
    recording = MemoryRecording(frames_at(truth), truth)
    assert isinstance(recording, EventSource)
    assert isinstance(recording, Recording)
    assert isinstance(Live(truth), EventSource)
    assert not isinstance(Live(truth), Recording)


def test_a_localizer_is_built_once_a_track(tmp_path: Path, truth: Trajectory, monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[tuple[str, ...]] = []
    begin = Localizer.__init__

    def counted(self: Localizer, calibration: Calibration, config: Config, *places: Any, **others: Any) -> None:
        built.append(config.odometry)
        begin(self, calibration, config, *places, **others)

    monkeypatch.setattr(Localizer, "__init__", counted)
    run_each(mixed_recording(truth), BOTH, tmp_path / "out")
    assert sorted(built) == [("features",), ("wheels",)]
