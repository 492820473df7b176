from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pipeline.made import (
    BOTH,
    BY_FEATURES,
    BY_WHEELS,
    FILES,
    OF_ONE,
    frames_at,
    metrics_in,
    mixed_recording,
    names_in,
)
from room_drive import make_room_drive
from stand_ins import MemoryRecording

from wheelsight.app.runs import run, run_each
from wheelsight.config import load_config
from wheelsight.core.errors import ConfigError
from wheelsight.core.trajectory import Trajectory, read_tum
from wheelsight.io.recordings import image_recording, open_recording


@pytest.mark.slow
@pytest.mark.usefixtures("real_odometry")
def test_several_odometries_answer_one_pass_as_each_alone_would(tmp_path: Path) -> None:
    make_room_drive(tmp_path / "room")
    passes: list[bool] = []

    class Counted:
        """The recording, and how often its events were asked for."""

        def __init__(self) -> None:
            self.inner = open_recording(tmp_path / "room")

        def __getattr__(self, name: str) -> Any:
            return getattr(self.inner, name)

        def events(self, *, images: bool = True) -> Any:
            passes.append(images)
            return self.inner.events(images=images)

    records = run_each(Counted(), BOTH, tmp_path / "both")
    assert passes == [True]
    assert [record.odometry for record in records] == ["wheels", "features"]
    assert names_in(tmp_path / "both") == {"wheels", "features", "metrics.json", "config.yaml", "report.html"}
    for record in records:
        assert names_in(tmp_path / "both" / record.odometry) == OF_ONE
        assert (record.estimate.body, record.evaluation is not None) == ("base", True)
        assert record.evaluation.ate.translation.rmse < 0.01  # type: ignore[union-attr]
        alone = BOTH.alone(record.odometry)  # type: ignore[arg-type]
        run(open_recording(tmp_path / "room"), alone, tmp_path / record.odometry)
        together, apart = (
            tmp_path / place / "trajectory.txt" for place in (f"both/{record.odometry}", record.odometry)
        )
        assert together.read_bytes() == apart.read_bytes()
    assert load_config(tmp_path / "both" / "config.yaml") == BOTH


def test_metrics_of_several_are_joined_below_their_names(tmp_path: Path, truth: Trajectory) -> None:
    run_each(mixed_recording(truth), BOTH, tmp_path)
    joint = metrics_in(tmp_path)
    assert list(joint["odometry"]) == ["wheels", "features"]
    assert joint["odometry"]["wheels"]["wheel_readings"]["processed"] == 30
    assert joint["odometry"]["features"]["frames"]["processed"] == 20
    for name, figures in joint["odometry"].items():
        alone = metrics_in(tmp_path / name)
        assert {key: alone[key] for key in ("frame", "trajectory", "evaluation")} == {
            key: figures[key] for key in ("frame", "trajectory", "evaluation")
        }
        assert alone["timing"]["elapsed_s"] == joint["elapsed_s"]


def test_wheels_alone_decode_no_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_room_drive(tmp_path / "room", frames=4)
    recording = open_recording(tmp_path / "room")

    def refuse(path: Path) -> None:
        raise AssertionError(f"{path} was read")

    monkeypatch.setattr(image_recording, "read_color", refuse)
    assert len(run(recording, BY_WHEELS, tmp_path / "out").estimate) == recording.wheel_count
    with pytest.raises(AssertionError, match="was read"):
        run(recording, BOTH.alone("features"), tmp_path / "features")


def test_what_happens_at_each_event_is_heard(tmp_path: Path, truth: Trajectory) -> None:
    heard: list[str] = []
    run_each(mixed_recording(truth), BOTH, tmp_path, on_event=lambda answers: heard.extend(answers))
    assert (heard.count("wheels"), heard.count("features"), len(heard)) == (30, 20, 50)


def test_several_keep_what_they_had_when_broken_off(tmp_path: Path, truth: Trajectory) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_each(mixed_recording(truth, stop_after=25), BOTH, tmp_path)
    poses = {name: len(read_tum(tmp_path / name / "trajectory.txt")) for name in ("wheels", "features")}
    assert sum(poses.values()) == 25
    joint = metrics_in(tmp_path)
    assert joint["interrupted"]
    for name, unit, listed in (("wheels", "readings", 30), ("features", "frames", 20)):
        broken_off = f"Interrupted by the user after {poses[name]} of {listed} {unit}."
        assert broken_off in joint["odometry"][name]["warnings"]


def test_one_that_cannot_run_leaves_nothing_of_the_others(tmp_path: Path, truth: Trajectory) -> None:
    images_only = MemoryRecording(frames_at(truth), truth, calibration=mixed_recording(truth).calibration)
    with pytest.raises(ConfigError, match=r"no wheel readings .--odometry features"):
        run_each(images_only, BOTH, tmp_path / "out")
    with pytest.raises(ConfigError, match="run_each"):
        run(mixed_recording(truth), BOTH, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_results_of_other_odometries_do_not_stay_beside_those_of_a_new_run(tmp_path: Path, truth: Trajectory) -> None:
    out = tmp_path / "out"
    run_each(mixed_recording(truth), BOTH, out)
    (out / "wheels" / "mine.txt").write_text("keep")
    run_each(mixed_recording(truth), BY_FEATURES, out, force=True)
    assert names_in(out) == FILES | {"wheels"}
    assert names_in(out / "wheels") == {"mine.txt"}
    run_each(mixed_recording(truth), BOTH, out, force=True)
    assert "trajectory.txt" not in names_in(out)
    assert names_in(out / "wheels") == OF_ONE | {"mine.txt"}


def test_a_folder_that_is_no_run_loses_nothing(tmp_path: Path, truth: Trajectory) -> None:
    (tmp_path / "trajectory.txt").write_text("somebody's own")
    run_each(mixed_recording(truth), BOTH, tmp_path, force=True)
    assert (tmp_path / "trajectory.txt").read_text() == "somebody's own"
