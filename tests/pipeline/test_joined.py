"""Runs of joined sensors through blackouts and slips: what the files and the records tell of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from localizer.joined_drives import CALIBRATION, Drive, Sight, drive, spinning
from pipeline.made import OF_JOINED, OF_ONE, metrics_in, names_in, status_in
from stand_ins import MemoryRecording

from wheelsight.app.run import RunRecord
from wheelsight.app.runs import run_each
from wheelsight.config import load_config
from wheelsight.core.errors import CalibrationError, ConfigError
from wheelsight.core.estimates import Reason, Status
from wheelsight.core.messages import Event, RgbdFrame, SkippedFrame, WheelTicks
from wheelsight.core.trajectory import read_tum

JOINED = load_config(overrides={"odometry": "wheels,features"})
BLACKOUT = Sight(Reason.TOO_LITTLE_DEPTH)
Runner = Callable[..., dict[str, RunRecord]]


def recording(made: Drive) -> MemoryRecording:
    return MemoryRecording(made.events(), replace(made.truth, body="base"), CALIBRATION)


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Runner:
    """Runs wheels, the camera that sees a drive, and both joined; their records by name, the files in `tmp_path`."""

    def run(made: Drive, given: MemoryRecording | None = None, **settings: object) -> dict[str, RunRecord]:
        monkeypatch.setattr("wheelsight.estimation.camera_localizer.FeatureOdometry", lambda *_, **__: made.eye())
        config = load_config(overrides={"odometry": "wheels,features"} | settings)
        return {record.odometry: record for record in run_each(given or recording(made), config, tmp_path)}

    return run


def dark_between(begin_s: float, end_s: float) -> Callable[[float], Sight]:
    return lambda seconds: BLACKOUT if begin_s < seconds < end_s else Sight()


def seconds_of(made: Drive, stamps_s: np.ndarray) -> np.ndarray:
    return np.asarray(stamps_s) - made.begin_s


def test_every_track_has_its_files(ran: Runner, tmp_path: Path) -> None:
    records = ran(drive())
    assert list(records) == ["wheels", "features", "joined"]
    assert names_in(tmp_path) == {"wheels", "features", "joined", "metrics.json", "config.yaml", "report.html"}
    for name in records:
        assert names_in(tmp_path / name) == (OF_JOINED if name == "joined" else OF_ONE)
    joined = records["joined"]
    assert (joined.estimate.body, joined.unit) == ("base", "frame")
    assert joined.evaluation is not None
    assert metrics_in(tmp_path / "joined")["frames"]["with_pose"] == len(joined.frames) == 150


def test_the_trajectory_goes_on_while_coasting(ran: Runner, tmp_path: Path) -> None:
    made = drive(faults=dark_between(2.0, 3.5))
    records = ran(made)
    dark = [f for f in records["joined"].frames if 2.0 < f.stamp_s - made.begin_s < 3.5]
    assert {frame.reason for frame in dark} == {Reason.TOO_LITTLE_DEPTH}
    assert {frame.status for frame in dark[10:]} == {Status.COASTING}
    written = read_tum(tmp_path / "joined" / "trajectory.txt")
    known_s, of_camera_s = (seconds_of(made, records[name].estimate.stamps_s) for name in ("joined", "features"))
    stamps_s = {frame.stamp_s for frame in dark}
    assert stamps_s <= set(records["joined"].estimate.stamps_s.tolist())
    assert len(written) == len(known_s)
    assert not ((of_camera_s > 2.0) & (of_camera_s < 3.5)).any()
    readings = made.readings.stamps_s
    assert set(readings[1:].tolist()) <= set(records["joined"].estimate.stamps_s.tolist())
    assert (np.diff(records["joined"].estimate.stamps_s) > 0).all()
    off = (
        records["joined"].estimate.T_frame_body[:, :3, 3] - made.truth.at(records["joined"].estimate.stamps_s)[:, :3, 3]
    )
    assert np.linalg.norm(off, axis=1).max() < 0.03
    assert records["joined"].estimate.covariances is not None


def test_slip_is_reported_by_flags_in_record_and_file(ran: Runner, tmp_path: Path) -> None:
    made = spinning(drive(), 2.0, 3.5, 0.6)
    frames = ran(made)["joined"].frames
    for frame in frames:
        second = frame.stamp_s - made.begin_s
        assert ("slip" in frame.flags or "doubtful" in frame.flags) or not 2.05 < second < 3.5
        assert not frame.flags or 2.0 < second < 4.0
    rows = status_in(tmp_path / "joined")
    assert [row["flags"] for row in rows] == [";".join(frame.flags) for frame in frames]
    assert sum("slip" in row["flags"] for row in rows) > 25


def test_directions_that_are_not_shown_are_reported_by_a_flag(ran: Runner, tmp_path: Path) -> None:
    hidden = Sight(hidden=np.array([[0.0, 0, 1, 0, 0, 0]]))
    made = drive(faults=lambda seconds: hidden if 2.0 < seconds < 3.5 else Sight())
    frames = ran(made, **{"fusion": "default"})["joined"].frames
    assert [f.flags for f in frames] == [
        ("degenerate",) if 2.0 < f.stamp_s - made.begin_s < 3.5 else () for f in frames
    ]


def test_frames_of_a_camera_in_another_epoch_keep_their_stamps_and_say_so(ran: Runner) -> None:
    made = drive(((2.0, 0.6, 0.2),))
    events: list[Event] = made.events()
    wheels = [event for event in events if not isinstance(event, RgbdFrame)]
    odd = [replace(event, stamp_s=event.stamp_s - 1e9) for event in events if isinstance(event, RgbdFrame)]
    mixed: list[Event] = [*wheels[:10], *(event for pair in zip(odd, wheels[10:], strict=False) for event in pair)]
    given = MemoryRecording(mixed, None, CALIBRATION)
    frames = ran(made, given)["joined"].frames
    assert [frame.stamp_s for frame in frames] == [frame.stamp_s for frame in odd]
    assert {frame.reason for frame in frames[1:]} == {Reason.CLOCKS_APART}
    assert {frame.status for frame in frames} == {Status.COASTING}


def test_skipped_frames_are_listed_with_what_was_wrong(ran: Runner, tmp_path: Path) -> None:
    made = drive(((2.0, 0.6, 0.2),))
    events: list[Event] = [
        SkippedFrame(e.stamp_s, "depth image is cut off", e.index) if isinstance(e, RgbdFrame) and e.index == 20 else e
        for e in made.events()
    ]
    records = ran(made, MemoryRecording(events, None, CALIBRATION))
    (row,) = (row for row in status_in(tmp_path / "joined") if row["note"])
    assert row["note"] == "depth image is cut off"
    assert records["joined"].frames[20].reason is Reason.FRAME_UNUSABLE
    assert records["joined"].frames[20].stamp_s in set(records["joined"].estimate.stamps_s.tolist())


def test_ligockis_answers_frames_alone(ran: Runner) -> None:
    made = drive()
    records = ran(made, fusion="ligocki")
    frames_s = [event.stamp_s for event in made.events() if isinstance(event, RgbdFrame)]
    assert records["joined"].estimate.stamps_s.tolist() == frames_s
    assert records["joined"].evaluation is not None


def test_what_cannot_be_joined_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    given = replace(recording(drive()), calibration=replace(CALIBRATION, T_base_camera=None))
    with pytest.raises(CalibrationError, match="wheelsight calibrate base"):
        run_each(given, JOINED, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("kept", "problem"), [(RgbdFrame, "no wheel readings .*--odometry features"), (WheelTicks, "no images .*wheels")]
)
def test_a_recording_without_one_of_both_is_refused(tmp_path: Path, kept: type, problem: str) -> None:
    given = replace(recording(drive()), given=[event for event in drive().events() if isinstance(event, kept)])
    with pytest.raises(ConfigError, match=problem):
        run_each(given, JOINED, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_ligockis_poses_while_coasting_are_part_of_the_trajectory(ran: Runner) -> None:
    made = drive(faults=dark_between(2.0, 3.5))
    records = ran(made, fusion="ligocki")
    frames_s = [event.stamp_s for event in made.events() if isinstance(event, RgbdFrame)]
    assert {f.status for f in records["joined"].frames if 2.0 < f.stamp_s - made.begin_s < 3.5} == {Status.COASTING}
    assert records["joined"].estimate.stamps_s.tolist() == frames_s
