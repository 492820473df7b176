"""The recording that comes with the package: small, whole, found by its name, and what its script makes again."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.sample import LARGEST_BYTES, write_sample
from wheelsight import open_recording
from wheelsight.app.cli import app
from wheelsight.core.errors import RecordingError
from wheelsight.core.messages import RgbdFrame
from wheelsight.core.trajectory import read_tum
from wheelsight.io.recordings import SAMPLE, SAMPLE_NAME


def test_it_is_small_and_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert sum(path.stat().st_size for path in SAMPLE.rglob("*") if path.is_file()) < LARGEST_BYTES
    recording = open_recording(SAMPLE_NAME)
    assert (recording.name, recording.warnings) == ("sample", ())
    assert recording.frame_count == len(list((SAMPLE / "depth").iterdir())) > 100
    assert recording.wheel_count > 1000
    assert recording.calibration.T_base_camera is not None
    truth = recording.ground_truth
    assert truth is not None
    way_m = np.linalg.norm(np.diff(truth.T_frame_body[:, :3, 3], axis=0), axis=1).sum()
    assert way_m == pytest.approx(20.5, abs=0.5)
    assert np.linalg.norm(truth.T_frame_body[-1, :3, 3] - truth.T_frame_body[0, :3, 3]) < 0.2


def test_all_its_frames_can_be_used() -> None:
    frames = [event for event in open_recording(SAMPLE).events() if isinstance(event, RgbdFrame)]
    assert len(frames) == len(list((SAMPLE / "rgb").iterdir()))
    assert min(np.mean(frame.depth_m > 0) for frame in frames) > 0.3


def test_a_folder_of_that_name_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sample").mkdir()
    with pytest.raises(RecordingError, match="no reader recognises this folder"):
        open_recording("sample")
    for path in (tmp_path / "no" / "sample", "other"):
        with pytest.raises(RecordingError, match="there is no such folder"):
            open_recording(path)


@pytest.mark.slow
def test_its_script_makes_it_again(tmp_path: Path) -> None:
    """The same readings; nearly all of depth on another processor, too, and colour as far as JPEG goes."""
    pytest.importorskip("mujoco")
    again = tmp_path / "sample"
    assert write_sample(again) < LARGEST_BYTES
    names = [sorted(path.relative_to(folder) for path in folder.rglob("*.*")) for folder in (again, SAMPLE)]
    assert names[0] == names[1]
    assert (again / "wheels.csv").read_text() == (SAMPLE / "wheels.csv").read_text()
    for name in names[0]:
        images = [cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED) for folder in (again, SAMPLE)]
        if images[0] is not None and images[1] is not None:
            off = cv2.absdiff(images[0], images[1])
            assert np.mean(off == 0) > 0.95 if name.suffix == ".png" else np.mean(off) < 1.0


@pytest.mark.slow
def test_it_is_joined_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first command of a newcomer, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["run", "sample", "--out", "first"])
    assert result.exit_code == 0, result.output
    figures = json.loads((tmp_path / "first" / "joined" / "metrics.json").read_text())
    assert figures["verdict"]["tone"] == "green"
    found = read_tum(tmp_path / "first" / "joined" / "trajectory.txt", body="base")
    truth = read_tum(SAMPLE / "groundtruth_base.txt", body="base")
    found = found.between(truth.stamps_s[0], truth.stamps_s[-1]).moved(truth.T_frame_body[0])
    off_m = np.linalg.norm(truth.at(found.stamps_s)[:, :3, 3] - found.T_frame_body[:, :3, 3], axis=1)
    assert off_m.max() < 0.2  # begun at the true start
    assert (tmp_path / "first" / "report.html").is_file()
